"""The study of the barrel: all controllers on all scenarios, variations, Monte Carlo.

1 kHz and sensor noise seed 1 unless a table says otherwise.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from pcpc.plants.atb1000.book.study_figures import draw_all, draw_monte_carlo
from pcpc.plants.book.tables import by_case, case_maker
from pcpc.plants.study import Case, Result, markdown, of_group

CHAPTER = 9
TITLE = "Chapter 9: the flexible barrel"
_case = case_maker(__file__)
SCENARIOS = ("slew10", "slew25", "bang10", "step10", "step25", "sin0.2", "sin0.5", "sin1.0", "hull",
             "hullrand", "lowspeed", "fire", "firetrack")  # fmt: skip
CONTROLLERS = ("pd", "pd_star", "pid", "pd_fast", "pd_nn", "pd_nn_fast", "nn_backstepping")
DRAWN = ("pd", "pid", "pd_nn_fast", "nn_backstepping")
CORE = ("slew10", "sin0.5", "hull")
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
        for scenario in ("slew10", "sin0.2", "sin0.5", "hull", "lowspeed", "fire"):
            yield _case("ablation", scenario, controller, label, *settings)
    for scenario in CORE:
        for controller in VARIED:
            for label, settings in VARIATIONS.items():
                yield _case("variation", scenario, controller, label, *settings)
            for rate in (500, 1000, 2000, 4000):
                yield _case("rate", scenario, controller, str(rate), f"rate_hz={rate}.0")
    for scenario, seeds in SEEDS.items():
        for seed in range(1, seeds + 1):
            for controller in ("pd", "pd_nn_fast", "nn_backstepping"):
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


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw signals and networks of the main scenarios, and the random plants."""
    draw_all([r for r in results if r.traces], folder)
    draw_monte_carlo(of_group(results, "monte carlo"), folder / "monte-carlo.png")


def _rms(result: Result) -> float:
    return result.metric("muzzle_error_rms_mrad")


def _short(result: Result) -> str:
    return f"{_rms(result):.3g} \\| {result.metrics.get('command_step_rms_Nm', float('nan')):.2g}"


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    return "\n".join((
        "Muzzle error rms in mrad, window of each scenario, 1 kHz, seed 1.\n",
        _main(results, lambda r: f"{_rms(r):.3g}"),
        "Largest muzzle error in mrad.\n",
        _main(results, lambda r: f"{r.metrics['muzzle_error_max_mrad']:.3g}"),
        "Step of the command from cycle to cycle, rms, N m at the output: what the gear feels.\n",
        _main(results, lambda r: f"{r.metrics['command_step_rms_Nm']:.2g}"),
        _ablations(results),
        _grid(results, "variation", "Variations: rms mrad | command step N m", list(VARIATIONS)),
        _grid(results, "rate", "Rates in Hz: rms mrad | command step N m",
              ["500", "1000", "2000", "4000"]),
        _seeds(results),
        _draws(results),
    ))  # fmt: skip


def _main(results: Sequence[Result], cell: Callable[[Result], str]) -> str:
    """Return a row a scenario, a column a controller."""
    main = by_case(results, "main")
    rows = [[s, *(cell(main[s, c, c]) for c in CONTROLLERS)] for s in SCENARIOS]
    return markdown(("scenario", *CONTROLLERS), rows)


def _ablations(results: Sequence[Result]) -> str:
    found = by_case(results, "ablation")
    scenarios = list(dict.fromkeys(key[0] for key in found))
    rows = [
        [label, *(_short(found[s, controller, label]) for s in scenarios)]
        for label, (controller, _) in ABLATIONS.items()
    ]
    return "Ablations: rms mrad | command step N m\n\n" + markdown(("", *scenarios), rows)


def _grid(results: Sequence[Result], group: str, title: str, labels: Sequence[str]) -> str:
    found = by_case(results, group)
    rows = [
        [label, scenario, *(_short(found[scenario, c, label]) for c in VARIED)]
        for label in labels
        for scenario in CORE
    ]
    return f"{title}\n\n" + markdown((group, "scenario", *VARIED), rows)


def _percentiles(values: Sequence[float]) -> str:
    points = np.percentile(values, (0, 50, 95, 100))
    return " / ".join(f"{p:.3g}" for p in points)


def _seeds(results: Sequence[Result]) -> str:
    found = by_case(results, "seeds")
    rows = []
    for scenario, seeds in SEEDS.items():
        row = [scenario, str(seeds)]
        for c in ("pd", "pd_nn_fast", "nn_backstepping"):
            own = [_rms(found[scenario, c, str(seed)]) for seed in range(1, seeds + 1)]
            base = [_rms(found[scenario, "pd", str(seed)]) for seed in range(1, seeds + 1)]
            row.append(
                f"{_percentiles(own)} ({max(a / b for a, b in zip(own, base, strict=True)):.3f})"
            )
        rows.append(row)
    text = "Noise seeds, nominal plant: rms mrad min / median / p95 / max (worst ratio to pd)\n\n"
    return text + markdown(("scenario", "seeds", "pd", "pd_nn_fast", "nn_backstepping"), rows)


def _draws(results: Sequence[Result]) -> str:
    found = by_case(results, "monte carlo")
    rows = []
    for scenario in ("slew10", "sin0.5", "hull"):
        base = [_rms(found[scenario, "pd", str(i)]) for i in range(DRAWS)]
        for c in ("pd", "pid", "pd_nn_fast", "nn_backstepping"):
            own = [_rms(found[scenario, c, str(i)]) for i in range(DRAWS)]
            ratio = [a / b for a, b in zip(own, base, strict=True)]
            diverged = sum(not np.isfinite(a) for a in own)
            rows.append(
                [scenario, c, _percentiles(own), f"{np.median(ratio):.3f} (worst {max(ratio):.3f})",
                 *(str(sum(times * a <= b for a, b in zip(own, base, strict=True)))
                   for times in (1.0, 2.3, 5.0)), str(diverged)]
            )  # fmt: skip
    text = (
        f"Monte Carlo, {DRAWS} draws of ten plant factors (hull: first 8 s): rms mrad "
        "min / median / p95 / max\n\n"
    )
    head = ("scenario", "controller", "rms", "ratio to pd", "draws better than pd", "2.3 times",
            "5 times", "diverged")  # fmt: skip
    return text + markdown(head, rows)
