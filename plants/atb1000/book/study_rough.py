"""What a rougher world costs each law: random barrels, each with and without it, all else equal.

A barrel is drawn as in study.py, the numbers of its rougher world as in `random_world`; a run has
the rig `rough` for 8 s, judged from 4 s on, with a noise seed of its own. A cost is the muzzle
error's rms over that of the same barrel, law and seed without; 95 % intervals are those of a
bootstrap over the barrels.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcpc.plants.atb1000.book.study import random_plant
from pcpc.plants.atb1000.book.study_rough_figure import draw_costs
from pcpc.plants.atb1000.ports import load_parameters
from pcpc.plants.study import Case, CaseResult, markdown

CHAPTER = 9
TITLE = "The barrel in a rougher world"
FOLDER = Path(__file__).resolve().parents[1]
RIG = FOLDER / "rigs" / "rough.yaml"
LAWS = ("pd", "pd_tuned", "pid", "pid_tuned", "pd_feedforward", "pd_observer", "super_twisting",
        "pd_adaptive", "lqg", "pd_nn_fast", "pd_nn_fast_tuned", "nn_backstepping")  # fmt: skip
NONE, ALL = "none", "all"
PARTS = {  # whole numbers: runs in lanes differ in none of them
    "gyros": "rough_gyros=1", "encoder": "rough_encoder=1", "motor": "rough_motor=1",
    "bearing": "rough_bearing=1", "hull": "rough_hull=1", "timing": "rough_timing=1",
    "1 sample late": "delay_samples=1", "2 samples late": "delay_samples=2",
}  # fmt: skip
BARRELS, IN_PARTS = 200, 50  # the first of them also with each part alone
DRAW_SEED, NOISE_SEED = 3031, 5000
DURATION_S, WINDOW_S = 8.0, (4.0, 8.0)
RESAMPLED = 2000
BAD = 95.0  # per cent of the barrels cost less
NOMINAL = load_parameters(FOLDER / "parameters.yaml")
RMS, STEP = "muzzle_error_rms_mrad", "command_step_rms_Nm"

Vector = NDArray[np.float64]


def random_world(rng: np.random.Generator) -> tuple[str, ...]:
    """Return settings of a rougher world: all phases, signs of bias, sizes within a factor."""
    turn = 2.0 * np.pi
    values = {
        f"{name}_gyro_bias_rad_s": rng.uniform(-1.5e-3, 1.5e-3)
        for name in ("hub", "muzzle", "hull")
    }
    for name in ("encoder_once", "encoder_twice", "cogging", "ripple"):
        values[f"{name}_phase_rad"] = rng.uniform(0.0, turn)
    for name in ("encoder_once_rad", "encoder_twice_rad", "cogging_Nm", "ripple"):
        values[name] = NOMINAL[name] * rng.uniform(0.5, 1.5)
    for name in (
        "gyro_walk_rad_s_rts",
        "bearing_J_K",
        "bearing_W_K",
        "hull_inertia_kg_m2",
        "hull_spring_Nm_rad",
        "hull_damper_Nms_rad",
    ):
        values[name] = NOMINAL[name] * 2.0 ** rng.uniform(-1.0, 1.0)
    for name in NOMINAL:
        if name.endswith("_age_s"):
            values[name] = NOMINAL[name] * rng.uniform(0.0, 2.0)
    values["ambient_K"] = rng.uniform(-30.0, 20.0)  # friction 1.8 to 0.67 times as large
    return tuple(f"barrel.{name}={float(value)!r}" for name, value in values.items())


def cases() -> Iterator[Case]:
    """Yield all runs: each law, with everything and with nothing, then in parts."""
    rng = np.random.default_rng(DRAW_SEED)
    barrels = [(*random_plant(rng), *random_world(rng)) for _ in range(BARRELS)]
    kinds = {NONE: "rough=0", ALL: "rough=1"} | {k: f"rough=0 {v}" for k, v in PARTS.items()}
    for law in LAWS:
        for kind, switches in kinds.items():
            first = tuple(f"barrel.{one}" for one in switches.split())
            for i in range(BARRELS if kind in (NONE, ALL) else IN_PARTS):
                settings = (f"duration_s={DURATION_S}", f"seed={NOISE_SEED + i}", *first)
                yield Case(kind, str(RIG), law, str(i), (*settings, *barrels[i]), WINDOW_S)


def column(results: Sequence[CaseResult], law: str, kind: str, metric: str = RMS) -> Vector:
    """Return a metric of a law's runs of a kind, (barrels,); infinite where one diverged."""
    own = [r for r in results if (r.case.controller, r.case.group) == (law, kind)]
    return np.array([r.metric(metric) for r in sorted(own, key=lambda r: int(r.case.label))])


def costs(results: Sequence[CaseResult], law: str, kind: str) -> Vector:
    """Return the ratios of rms, with over without, of the same barrels, (barrels,)."""
    found = column(results, law, kind)
    return found / column(results, law, NONE)[: len(found)]


def interval(values: Vector) -> tuple[float, float, float]:
    """Return the median of values (n,) and its 95 % interval."""
    rng = np.random.default_rng(1)
    drawn = values[rng.integers(len(values), size=(RESAMPLED, len(values)))]
    low, high = np.percentile(np.median(drawn, axis=1), (2.5, 97.5))
    return float(np.median(values)), float(low), float(high)


def best(results: Sequence[CaseResult], kind: str) -> dict[str, int]:
    """Return on how many barrels each law is the best."""
    table = np.stack([column(results, law, kind) for law in LAWS])
    wins = np.bincount(np.argmin(table, axis=0), minlength=len(LAWS))
    return dict(zip(LAWS, wins.tolist(), strict=True))


def report(results: Sequence[CaseResult]) -> str:
    """Return the tables."""
    head = ("", "without", "with all", "cost", "95 % cost less than", "largest", "best without",
            "best with", "step without", "step with", "ended early")  # fmt: skip
    before, after = best(results, NONE), best(results, ALL)
    rows = []
    for law in LAWS:
        pair = [column(results, law, kind) for kind in (NONE, ALL)]
        steps = [column(results, law, kind, STEP) for kind in (NONE, ALL)]
        ratio = costs(results, law, ALL)
        rows.append(
            [law, *(f"{np.median(one):.3g}" for one in pair), _median_cost(ratio),
             f"{_bad(ratio):.2f}", f"{ratio.max():.2f}", str(before[law]), str(after[law]),
             *(f"{np.median(one):.2g}" for one in steps), str(int(np.isinf(pair[1]).sum()))]
        )  # fmt: skip
    parts = [
        [kind, *(f"{np.median(one):.2f}, {_bad(one):.2f}" for one in some)]
        for kind, some in ((k, [costs(results, law, k) for law in LAWS]) for k in PARTS)
    ]
    return (
        f"{BARRELS} random barrels, medians: muzzle error rms in mrad without the rougher world "
        "and with all of it, their ratio on the same barrel with its 95 % interval, on how many "
        "barrels a law is the best, the command's step from cycle to cycle in N m.\n\n"
        f"{markdown(head, rows)}\n"
        f"Each part alone, {IN_PARTS} barrels: median cost, and what {BAD:g} % of them stay below."
        "\n\n"
        f"{markdown(('', *LAWS), parts)}"
    )


def _median_cost(values: Vector) -> str:
    middle, low, high = interval(values)
    return f"{middle:.3f} ({low:.3f} to {high:.3f})"


def _bad(values: Vector) -> float:
    return float(np.percentile(values, BAD, method="higher"))  # between infinite ones is nothing


def draw(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw the cost of each part for each law, and the errors without and with all."""
    kinds = (*PARTS, ALL)
    table = np.array([[_bad(costs(results, law, kind)) for law in LAWS] for kind in kinds])
    errors = [[column(results, law, kind) for law in LAWS] for kind in (NONE, ALL)]
    draw_costs(kinds, LAWS, table, errors, folder / "rough.png")
