"""The study of the two-link arm with friction: five cases, six controllers, ten networks.

Figures are medians over the seeds of the network's first layer; in brackets, beside each, what an
independent implementation of the same equations gave.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from pcpc.plants.book.tables import bracketed_cells, case_maker, expected_figures
from pcpc.plants.friction_arm.book.study_figures import draw_all
from pcpc.plants.study import Case, Result, markdown, of_group, statistic

CHAPTER = 3
TITLE = "Chapter 3: the two-link arm with friction"
_case, known = case_maker(__file__, "friction-"), expected_figures(__file__)
NETWORKS = ("nn_standard", "nn_step", "nn_ramp", "nn_project", "nn_const")
SEEDS, FEW_SEEDS = range(1, 11), range(1, 6)
DRAWN = ("pd", "nn_standard", "nn_step", "nn_ramp", "nn_const")
RATES_HZ = (5000, 2000, 1000, 500, 250, 100, 50, 20, 10, 8)
QUANTA = {
    "none but the bus": (),
    "torque 0.1 N m": ("arm.torque_lsb_Nm=0.1",),
    "torque 1 N m": ("arm.torque_lsb_Nm=1.0",),
    "q 1e-4 and q' 1e-3": ("arm.position_lsb_rad=1e-4", "arm.rate_lsb_rad_s=1e-3"),
    "q 1e-3 and q' 1e-2": ("arm.position_lsb_rad=1e-3", "arm.rate_lsb_rad_s=1e-2"),
}
DELAYS = (0, 1, 2, 5)
GAINS = {
    "T 35 E 10": ("controller.t_rate=35.0", "controller.e_rate=10.0"),
    "T 10 E 10": ("controller.e_rate=10.0",),
    "T 10 E 100": ("controller.e_rate=100.0",),
}
GAINS_OF = {"nn_standard": ("T 35 E 10",), "nn_step": tuple(GAINS)}  # E is of the jump nodes only
NODES = (8, 12, 16)
STEPS_S = ("1e-3", "1e-4", "1e-5")
TRACES = (
    "executive:reference_1.q_d_rad", "executive:reference_2.q_d_rad",
    "plant:arm.q_1_rad", "plant:arm.q_2_rad", "plant:arm.acting_1_Nm", "plant:arm.acting_2_Nm",
    "error_1_rad", "error_2_rad", "plant:arm.rate_1_rad_s", "plant:arm.rate_2_rad_s",
    "executive:reference_1.q_d_rate_rad_s", "executive:reference_2.q_d_rate_rad_s",
    "executive:controller.norm_z", "executive:controller.tuning_gain_Nms_rad",
    "executive:controller.step_weight_1_Nm", "executive:controller.step_weight_2_Nm",
)  # fmt: skip


def _seed_cases(
    group: str, rig: str, controller: str, label: str, seeds: Sequence[int], *settings: str
) -> Iterator[Case]:
    for seed in seeds:
        drawn = f"controller.network_seed={seed}"
        yield _case(group, rig, controller, label, drawn, *settings)


def cases() -> Iterator[Case]:
    """Yield all runs of the study."""
    for rig in "abcde":
        yield _case(rig, rig, "pd", "pd")
        for controller in NETWORKS:
            yield from _seed_cases(rig, rig, controller, controller, SEEDS)
    for controller in ("nn_standard", "nn_step"):
        yield from _seed_cases("kz", "a", controller, controller, SEEDS, "controller.kz=0.0")
    kv = ("controller.kv_1_Nms_rad=23.0", "controller.kv_2_Nms_rad=23.0")
    yield _case("stiff pd", "a", "pd", "Kv 23", *kv)
    yield from _gains_and_nodes()
    yield from _sampling_cases()
    for rig in "abcd":
        for controller in DRAWN:
            yield _case("drawn", rig, controller, controller, traces=TRACES)
    for controller in ("nn_step", "nn_ramp", "nn_project", "nn_const"):
        yield _case(
            "zoom",
            "a",
            controller,
            controller,
            "duration_s=2.9",
            traces=TRACES,
            window_s=(0.0, 2.9),
        )


def _gains_and_nodes() -> Iterator[Case]:
    for controller, labels in GAINS_OF.items():
        for label in labels:
            yield from _seed_cases("gains", "a", controller, label, SEEDS, *GAINS[label])
        for nodes in NODES:
            setting = f"controller.nodes={nodes}.0"
            yield from _seed_cases("nodes", "a", controller, str(nodes), SEEDS, setting)


def _sampling_cases() -> Iterator[Case]:
    for controller in ("nn_standard", "nn_step", "nn_ramp"):
        for rate in RATES_HZ:
            setting = f"rate_hz={rate}.0"
            yield from _seed_cases("rates", "a", controller, str(rate), FEW_SEEDS, setting)
    for controller in ("nn_standard", "nn_step", "nn_ramp", "nn_project"):
        for label, settings in QUANTA.items():
            yield from _seed_cases("quanta", "a", controller, label, FEW_SEEDS, *settings)
    for delay in DELAYS:
        setting = f"arm.delay_samples={delay}.0"
        yield from _seed_cases("delays", "a", "nn_step", str(delay), FEW_SEEDS, setting)
    for step in STEPS_S:
        yield from _seed_cases("steps", "a", "nn_standard", step, range(1, 4), f"arm.step_s={step}")


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw cases A to D, phase planes, the chatter of the step node and the step weights."""
    draw_all(results, folder)


Key = tuple[str, str]
EARLY, LATE = "early_error_abs_mean_{}_rad", "error_abs_mean_{}_rad"


def _runs(results: Sequence[Result], group: str) -> dict[Key, list[Result]]:
    """Return the runs of a group by (controller, label), the seeds of each."""
    found: dict[Key, list[Result]] = {}
    for result in of_group(results, group):
        found.setdefault((result.case.controller, result.case.label), []).append(result)
    return found


def _number(value: float) -> str:
    """Return four decimals below 1, else three digits."""
    if not np.isfinite(value):
        return "-" if np.isnan(value) else "inf"
    return f"{value:.4f}" if abs(value) < 10.0 else f"{value:.0f}"


def _pair(runs: Sequence[Result], metric: str, of: Callable[..., float] = np.median) -> str:
    names = [metric.format(joint) for joint in (1, 2)]
    return " / ".join(_number(statistic(runs, name, of)) for name in names)


def _peak(runs: Sequence[Result]) -> str:
    return f"{statistic(runs, 'torque_peak_Nm', np.max):.0f}"


def _variation(runs: Sequence[Result]) -> str:
    return f"{statistic(runs, 'torque_variation_Nm_s', np.median):.0f}"


def _overshoot(runs: Sequence[Result]) -> str:
    return _number(statistic(runs, "overshoot_1_rad", np.median))


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    heads = {
        "a": "Case A: unit step under gravity",
        "b": "Case B: unit step without gravity",
        "d": "Case D: LuGre friction, unit step under gravity",
        "e": "Case E: stiction a1 = 10 N m, unit step under gravity",
        "kz": "Case A without the robust term, Kz = 0",
    }
    parts = [
        "Joint 1 / joint 2; rad, N m, N m/s. Medians over the seeds 1 to 10 of the first layer; in "
        "brackets the figures of an independent implementation of the same equations. Errors are "
        "means of |e|; overshoot is beyond the target; variation is the sum of |tau_k - tau_k-1| "
        "of both joints per second; the peak torque is that of all seeds.\n"
    ]
    for group, head in heads.items():
        parts.append(f"{head}\n\n" + _regulation(results, group))
    parts.append("Case C: tracking sin t, cos t\n\n" + _tracking(results))
    stiff = of_group(results, "stiff pd")
    parts.append(
        "PD with the damping that the robust term adds, Kv = 23, case A: "
        f"{bracketed_cells([_pair(stiff, LATE)], known('stiff pd', 'pd'))[0]}\n"
    )
    parts += [_tunings(results), _rates(results), _quanta(results), _delays(results)]
    return "\n".join(parts)


def _regulation(results: Sequence[Result], group: str) -> str:
    rows = []
    for (controller, _), runs in _runs(results, group).items():
        cells = (
            _pair(runs, EARLY),
            _pair(runs, LATE),
            _pair(runs, LATE, np.max) if controller != "pd" else "-",
            _pair(runs, "overshoot_{}_rad") if controller != "pd" else "-",
            _peak(runs),
            _variation(runs),
        )
        rows.append([controller, *bracketed_cells(cells, known(group, controller))])
    head = ("", "4 to 5 s", "9 to 10 s", "worst seed, 9 to 10 s", "overshoot", "peak", "variation")
    return markdown(head, rows)


def _tracking(results: Sequence[Result]) -> str:
    rows = []
    for (controller, _), runs in _runs(results, "c").items():
        cells = (
            _pair(runs, "error_rms_{}_rad"),
            _pair(runs, "error_max_{}_rad"),
            _variation(runs),
        )
        rows.append([controller, *bracketed_cells(cells, known("c", controller))])
    return markdown(("", "rms, 10 to 20 s", "largest, 10 to 20 s", "variation"), rows)


def _tunings(results: Sequence[Result]) -> str:
    parts = []
    for group, title in (
        ("gains", "Tuning gains instead of T 10 E 35, with S = 10, case A"),
        ("nodes", "Hidden nodes instead of 10, case A"),
    ):
        rows = []
        for (controller, label), runs in _runs(results, group).items():
            cells = (
                _pair(runs, EARLY),
                _pair(runs, LATE),
                _peak(runs),
            )
            other = known(group, controller, label)
            rows.append([label, controller, *bracketed_cells(cells, other)])
        parts.append(
            f"{title}\n\n" + markdown(("", "law", "4 to 5 s", "9 to 10 s", "peak torque"), rows)
        )
    return "\n".join(parts)


def _rates(results: Sequence[Result]) -> str:
    found = _runs(results, "rates")
    rows = []
    for rate in map(str, RATES_HZ):
        standard, step, ramp = (found[c, rate] for c in ("nn_standard", "nn_step", "nn_ramp"))
        cells = (
            _pair(standard, LATE),
            _pair(step, LATE),
            _variation(step),
            _variation(ramp),
            _overshoot(step),
        )
        gain = statistic(step, "tuning_gain_median_Nms_rad", np.median)
        rows.append([rate, *bracketed_cells(cells, known("rates", rate)), f"{gain:.3g}"])
    head = ("Hz", "nn_standard, 9 to 10 s", "nn_step, 9 to 10 s", "nn_step variation",
            "nn_ramp variation", "nn_step overshoot 1", "nn_step median T G")  # fmt: skip
    return "Sampling rate, case A, medians over 5 seeds; Kv is 20\n\n" + markdown(head, rows)


def _quanta(results: Sequence[Result]) -> str:
    rows = []
    for (controller, label), runs in _runs(results, "quanta").items():
        cells = (
            _pair(runs, LATE),
            _pair(runs, LATE, np.max),
            _variation(runs),
        )
        rows.append(
            [label, controller, *bracketed_cells(cells, known("quanta", controller, label))]
        )
    head = ("quantum", "law", "9 to 10 s", "worst of 5 seeds", "variation")
    return "Quantisation, case A\n\n" + markdown(head, rows)


def _delays(results: Sequence[Result]) -> str:
    rows = []
    for (_, label), runs in _runs(results, "delays").items():
        other = bracketed_cells([_overshoot(runs)], known("delays", label))
        rows.append([label, _pair(runs, LATE), *other])
    text = "Delay of the torque in samples, case A, nn_step, medians over 5 seeds\n\n"
    text += markdown(("samples", "9 to 10 s", "overshoot 1"), rows)
    rows = [
        [label, _pair(runs, EARLY), _pair(runs, LATE)]
        for (_, label), runs in _runs(results, "steps").items()
    ]
    text += "\nIntegration step, case A, nn_standard, medians over 3 seeds\n\n"
    return text + markdown(("step [s]", "4 to 5 s", "9 to 10 s"), rows)
