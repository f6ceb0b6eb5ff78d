"""The study of the barrel: all controllers on all scenarios, variations, Monte Carlo.

1 kHz and sensor noise seed 1 unless a table says otherwise.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from pcpc.plants.atb1000.book.study_figures import draw_all, draw_monte_carlo
from pcpc.plants.book.tables import (
    Column,
    RunsTable,
    across,
    case_maker,
    controller_of,
    group_of,
    grouped,
    label_of,
    page,
    recorded,
    rig_name,
)
from pcpc.plants.study import Case, CaseResult, of_group

CHAPTER = 9
TITLE = "Chapter 9: the flexible barrel"
_case = case_maker(__file__)
SCENARIOS = ("slew10", "slew25", "bang10", "step10", "step25", "sin0.2", "sin0.5", "sin1.0", "hull",
             "hullrand", "lowspeed", "fire", "firetrack")  # fmt: skip
CONTROLLERS = ("pd", "pd_star", "pid", "pd_fast", "pd_nn", "pd_nn_fast", "nn_backstepping")
DRAWN = ("pd", "pid", "pd_nn_fast", "nn_backstepping")
CORE = ("slew10", "sin0.5", "hull")
ABLATED = ("slew10", "sin0.2", "sin0.5", "hull", "lowspeed", "fire")
SEEDED = ("pd", "pd_nn_fast", "nn_backstepping")
VARIED = ("pd", "pid", "pd_fast", "pd_nn_fast", "nn_backstepping")

NOMINAL = {
    "coulomb_Nm": 2.0, "breakaway_Nm": 3.0, "sig2_Nms_rad": 0.8, "motor_coulomb_Nm": 0.020,
    "motor_viscous_Nms_rad": 1e-4, "tip_mass_kg": 0.15, "gap_rad": 1e-3, "ks_Nm_rad": 6e4,
    "cs_Nms_rad": 40.0, "hub_inertia_kg_m2": 1.2, "unbalance_Nm": 2.5, "young_Pa": 205e9,
    "zeta1": 0.008, "zeta2": 0.008, "zeta3": 0.010, "mesh_loss": 0.06,
}  # fmt: skip
FRICTION = ("coulomb_Nm", "breakaway_Nm", "sig2_Nms_rad", "motor_coulomb_Nm",
            "motor_viscous_Nms_rad")  # fmt: skip
DRAWS, DRAW_SEED, NOISE_SEED = 50, 2024, 1000
SEEDS = {"hull": 50, "sin0.5": 50, "sin0.2": 10}  # a gap limit cycle makes one seed worthless

TRACES = (
    "executive:reference.q_d_rad", "plant:barrel.theta_rad", "muzzle_error_rad", "hub_error_rad",
    "plant:barrel.elastic_slope_rad", "command_Nm", "executive:controller.e_rad",
    "executive:controller.r_rad_s", "executive:controller.network_Nm",
    "executive:controller.norm_z", "executive:controller.inner_Nm", "executive:controller.norm_z2",
    "plant:barrel.theta_rate_rad_s", "executive:reference.q_d_rate_rad_s",
)  # fmt: skip


def scaled_settings(**factors: float) -> tuple[str, ...]:
    """Return settings: nominal plant values times factors."""
    return tuple(f"barrel.{name}={NOMINAL[name] * factor!r}" for name, factor in factors.items())


VARIATIONS: dict[str, tuple[str, ...]] = {
    "friction x2": scaled_settings(**dict.fromkeys(FRICTION, 2.0)),
    "muzzle mass +50 %": scaled_settings(tip_mass_kg=1.5),
    "backlash x3": scaled_settings(gap_rad=3.0),
    "all three": scaled_settings(**dict.fromkeys(FRICTION, 2.0), tip_mass_kg=1.5, gap_rad=3.0),
    "static Stribeck": ("barrel.friction_model=1.0",),
}
ABLATIONS: dict[str, tuple[str, tuple[str, ...]]] = {
    "pd_nn_fast": ("pd_nn_fast", ()),
    "no jump nodes": ("pd_nn_fast", ("controller.fj_rate=0.0",)),
    "jump nodes only": ("pd_nn_fast", ("controller.f_rate=1.0",)),
    "first layer fixed": ("pd_nn_fast", ("controller.g_rate=0.0",)),
    "no e-modification": ("pd_nn_fast", ("controller.kappa=0.0",)),
    "e-modification x10": ("pd_nn_fast", ("controller.kappa=0.1",)),
    "no shaft damping": ("pd_nn_fast", ("controller.km_Nms_rad=0.0",)),
    "nn_backstepping": ("nn_backstepping", ()),
    "no inner network": (
        "nn_backstepping",
        ("controller.f2_rate=0.0", "controller.fj2_rate=0.0", "controller.g2_rate=0.0"),
    ),
}


def cases() -> Iterator[Case]:
    """Yield all runs of the experiment."""
    for scenario in SCENARIOS:
        for controller in CONTROLLERS:
            traces = TRACES if controller in DRAWN else ()
            yield _case("main", scenario, controller, controller, traces=traces)
    for label, (controller, settings) in ABLATIONS.items():
        for scenario in ABLATED:
            yield _case("ablation", scenario, controller, label, *settings)
    for scenario in CORE:
        for controller in VARIED:
            for label, settings in VARIATIONS.items():
                yield _case("variation", scenario, controller, label, *settings)
            for rate in (500, 1000, 2000, 4000):
                yield _case("rate", scenario, controller, str(rate), f"rate_hz={rate}.0")
    for scenario, seeds in SEEDS.items():
        for seed in range(1, seeds + 1):
            for controller in SEEDED:
                yield _case("seeds", scenario, controller, str(seed), f"seed={seed}")
    yield from monte_carlo()


def random_plant(rng: np.random.Generator) -> tuple[str, ...]:
    """Return settings: nominal values times ten factors drawn from `rng`."""
    low = (-1, 0.7, -1, 0.7, 0.5, 0.8, -1, 0.85, 0.5, 0.5)
    high = (1, 1.5, 1, 1.3, 2, 1.2, 2, 1.15, 2, 2)
    u = [float(rng.uniform(a, b)) for a, b in zip(low, high, strict=True)]
    return scaled_settings(
        **dict.fromkeys(FRICTION, 2.0 ** u[0]),
        tip_mass_kg=u[1],
        gap_rad=3.0 ** u[2],
        ks_Nm_rad=u[3],
        cs_Nms_rad=u[4],
        hub_inertia_kg_m2=u[5],
        unbalance_Nm=u[6],
        young_Pa=u[7],
        zeta1=u[8],
        zeta2=u[8],
        zeta3=u[8],
        mesh_loss=u[9],
    )


def monte_carlo() -> Iterator[Case]:
    """Yield 50 draws of ten plant factors, in three scenarios, for four controllers."""
    rng = np.random.default_rng(DRAW_SEED)
    for i in range(DRAWS):
        settings = random_plant(rng)
        seed = f"seed={NOISE_SEED + i}"
        for controller in ("pd", "pid", "pd_nn_fast", "nn_backstepping"):
            yield _case("monte carlo", "slew10", controller, str(i), seed, *settings)
            yield _case("monte carlo", "sin0.5", controller, str(i), seed, *settings)
            first = (seed, "duration_s=8.0", *settings)
            yield _case("monte carlo", "hull", controller, str(i), *first, window_s=(4.0, 8.0))


def draw(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw signals and networks of the main scenarios, and the random plants."""
    draw_all([r for r in results if r.traces], folder)
    draw_monte_carlo(of_group(results, "monte carlo"), folder / "monte-carlo.png")


Pairs = Sequence[tuple[float, float]]  # of a run and PD's, of the same barrel and noise


def rms(result: CaseResult) -> float:
    """Return the muzzle error of a run, mrad."""
    return result.metric("muzzle_error_rms_mrad")


def rms_and_step(result: CaseResult) -> str:
    """Return the muzzle error and the step of the command."""
    return f"{rms(result):.3g} \\| {recorded('command_step_rms_Nm')(result):.2g}"


def percentiles(pairs: Pairs) -> str:
    """Return the least error, the median, the 95th percentile and the largest."""
    points = np.percentile([own for own, _ in pairs], (0, 50, 95, 100))
    return " / ".join(f"{point:.3g}" for point in points)


def ratios(pairs: Pairs) -> list[float]:
    """Return errors over PD's."""
    return [own / base for own, base in pairs]


def at_least(times: float) -> Callable[[Pairs], str]:
    """Return what counts the runs that are so many times better than PD's."""
    return lambda pairs: str(sum(times * own <= base for own, base in pairs))


def main_table(
    title: str, source: Callable[[CaseResult], float], text: str = "{:.3g}"
) -> RunsTable:
    """Return a row a scenario, a column a controller."""
    columns = across(controller_of, CONTROLLERS, Column("{}", source, text=text))
    return RunsTable("main", columns, title, {"scenario": rig_name})


def grid(group: str, title: str) -> RunsTable:
    """Return a row a label and scenario, a column a controller."""
    columns = across(controller_of, VARIED, Column("{}", rms_and_step))
    return RunsTable(
        group,
        columns,
        f"{title}: rms mrad | command step N m",
        {group: label_of, "scenario": rig_name},
        nested=True,
    )


TABLES = (
    main_table("Muzzle error rms in mrad, window of each scenario, 1 kHz, seed 1.", rms),
    main_table("Largest muzzle error in mrad.", recorded("muzzle_error_max_mrad")),
    main_table(
        "Step of the command from cycle to cycle, rms, N m at the output: what the gear feels.",
        recorded("command_step_rms_Nm"),
        "{:.2g}",
    ),
    RunsTable(
        "ablation",
        across(rig_name, ABLATED, Column("{}", rms_and_step)),
        "Ablations: rms mrad | command step N m",
    ),
    grid("variation", "Variations"),
    grid("rate", "Rates in Hz"),
)


def report(results: Sequence[CaseResult]) -> str:
    """Return the tables."""
    pd = {
        names: rms(runs[0])
        for names, runs in grouped(results, group_of, rig_name, label_of, controller_of).items()
        if names[-1] == "pd"
    }

    def pair(result: CaseResult) -> tuple[float, float]:
        """Return the error of a run, and PD's of the same barrel and noise."""
        return rms(result), pd[result.case.group, rig_name(result), label_of(result), "pd"]

    seeds = RunsTable(
        "seeds",
        across(
            controller_of,
            SEEDED,
            Column("{}", pair, lambda own: f"{percentiles(own)} ({max(ratios(own)):.3f})"),
        ),
        "Noise seeds, nominal plant: rms mrad min / median / p95 / max (worst ratio to pd)",
        {"scenario": rig_name, "seeds": lambda result: SEEDS[rig_name(result)]},
    )
    draws = RunsTable(
        "monte carlo",
        (
            Column("rms", pair, percentiles),
            Column(
                "ratio to pd",
                pair,
                lambda own: f"{np.median(ratios(own)):.3f} (worst {max(ratios(own)):.3f})",
            ),
            Column("draws better than pd", pair, at_least(1.0)),
            Column("2.3 times", pair, at_least(2.3)),
            Column("5 times", pair, at_least(5.0)),
            Column("diverged", pair, lambda own: str(sum(not np.isfinite(a) for a, _ in own))),
        ),
        f"Monte Carlo, {DRAWS} draws of ten plant factors (hull: first 8 s): rms mrad "
        "min / median / p95 / max",
        {"scenario": rig_name, "controller": controller_of},
        nested=True,
    )
    return page(results, (*TABLES, seeds, draws))
