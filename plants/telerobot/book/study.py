"""The study of the telerobot: three scenarios, six controllers, delays, losses, wrong models.

Figures are rms errors of joint 1 / joint 2; in brackets, beside each, what an independent
implementation of the same equations gave.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from pcpc.plants.book.tables import (
    bracketed_cells,
    by_case,
    case_maker,
    expected_figures,
    results_by_run,
)
from pcpc.plants.study import Case, Result, markdown, of_group
from pcpc.plants.telerobot.book.study_figures import draw_all

CHAPTER = 8
TITLE = "Chapter 8: a telerobot behind a delay"
_case, known = case_maker(__file__, "telerobot-"), expected_figures(__file__)
CONTROLLERS = ("pd_near", "pd", "pd_match", "pd_slow", "smith", "nornn", "rnn")
DRAWN = ("pd_near", "pd_slow", "smith", "nornn", "rnn")
DELAYED = ("pd", "smith", "nornn", "rnn")
DELAYS_S = (0.1, 0.2, 0.3, 0.4, 0.5)
LIMIT_S = (0.04, 0.044, 0.046, 0.05)
BURSTS = (1, 5, 20)
LOSSES = ((0.01, 1), *((0.1, burst) for burst in BURSTS))
UPLINK = ("TELL_Q", "TELL_V", "ECHO")
TRACES = (
    "executive:controller.aim_1_rad", "executive:controller.aim_2_rad",
    "plant:arm.q_1_rad", "plant:arm.q_2_rad", "error_1_rad", "error_2_rad",
)  # fmt: skip
STOPPED = "unstable"

CHANGED: dict[str, tuple[str, ...]] = {
    "as it is": (),
    **{f"torque {d} samples old": (f"arm.delay_samples={d}.0",) for d in range(1, 6)},
    "q 2e-4 rad, q' 1e-3 rad/s": ("arm.position_lsb_rad=2e-4", "arm.rate_lsb_rad_s=1e-3"),
    "u 0.01 rad/s2": ("controller.u_lsb_rad_s2=0.01",),
    "u 1 rad/s2": ("controller.u_lsb_rad_s2=1.0",),
    "torque 0.1 N m": ("arm.torque_lsb_Nm=0.1",),
    "torque 1 N m": ("arm.torque_lsb_Nm=1.0",),
    "20 integration steps": ("arm.substeps=20.0",),
    "kap 1": ("servo.kap=1.0",),
    "kap 10": ("servo.kap=10.0",),
}
OFFSETS = (-40, -10, -2, -1, 0, 1, 2, 10, 40)  # ticks by which z is looked up too early


def cases() -> Iterator[Case]:
    """Yield all runs of the study."""
    for rig in ("u0", "u1", "u2"):
        for controller in CONTROLLERS:
            drawn = TRACES if rig == "u2" and controller in DRAWN else ()
            yield _case("scenarios", rig, controller, rig, traces=drawn)
    for delay in DELAYS_S:
        for controller in DELAYED:
            yield _case("delays", "u2", controller, str(delay), f"controller.delay_s={delay}")
    for rig in ("u0", "u1"):
        for delay in LIMIT_S:
            yield _case("limit", rig, "pd_match", str(delay), f"controller.delay_s={delay}")
    for label, settings in CHANGED.items():
        yield _case("changed", "u2", "rnn", label, *settings)
    for offset in OFFSETS:
        setting = f"controller.history_offset_ticks={offset}.0"
        yield _case("offsets", "u2", "rnn", str(offset), setting)
    for echo in (1, 0):
        for frames in (("U",), ("TELL_Q",), UPLINK):
            yield from _lossy(echo, frames)
    yield _case("long", "u2", "rnn", "100 s", "duration_s=100.0")


def _lossy(echo: int, frames: Sequence[str]) -> Iterator[Case]:
    for share, burst in LOSSES:
        settings = [f"controller.use_echo={echo}.0"]
        for frame in frames:
            settings += [f"losses.{frame}.share={share}", f"losses.{frame}.burst={burst}.0"]
        label = f"{'+'.join(frames)} {share} {burst} {echo}"
        yield _case("losses", "u2", "rnn", label, *settings)


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw the default scenario, and errors over delay, wrong delay and bursts."""
    draw_all(results, results_by_run(results, "losses"), BURSTS, folder)


def pair(result: Result, part: str = "") -> str:
    """Return the rms errors of both joints; STOPPED where a joint tripped."""
    if "tripped_s" in result.metrics:
        return STOPPED
    values = [result.metrics.get(f"{part}error_rms_{j}_rad", float("nan")) for j in (1, 2)]
    return " / ".join(f"{value:.4f}".removeprefix("0") for value in values)


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    return "\n".join(
        (
            "rms error of joint 1 / joint 2, rad, against the reference of T ago; in brackets the "
            "figures of an independent implementation of the same equations. Unstable: a joint "
            "came to 20 rad/s and the robot's node stopped the arm.\n",
            _scenarios(results),
            _delays(results),
            _change_tables(results),
            _losses(results),
        )
    )


def _scenarios(results: Sequence[Result]) -> str:
    runs, rows = results_by_run(results, "scenarios"), []
    for controller in CONTROLLERS:
        u0, u1, u2 = (runs[controller, rig] for rig in ("u0", "u1", "u2"))
        cells = (pair(u0), pair(u1), pair(u2, "before_"), pair(u2, "load_"), pair(u2))
        rows.append([controller, *bracketed_cells(cells, known("scenarios", controller))])
    head = ("", "U0, 15 to 20 s", "U1, 15 to 20 s", "U2, 5 to 10 s", "U2, 10 to 15 s",
            "U2, 15 to 20 s")  # fmt: skip
    return "Scenarios, T = 0.2 s\n\n" + markdown(head, rows)


def _delays(results: Sequence[Result]) -> str:
    runs, limits = results_by_run(results, "delays"), by_case(results, "limit")
    rows = [
        [d, *bracketed_cells([pair(runs[c, d]) for c in DELAYED], known("delays", d))]
        for d in map(str, DELAYS_S)
    ]
    limit = [
        [d, *(pair(limits[f"telerobot-{rig}", "pd_match", d]) for rig in ("u0", "u1"))]
        for d in map(str, LIMIT_S)
    ]
    return (
        "Delay, U2, 15 to 20 s\n\n"
        + markdown(("T [s]", *DELAYED), rows)
        + "\npd_match at its limit of 0.044 s, 15 to 20 s\n\n"
        + markdown(("T [s]", "U0", "U1"), limit)
    )


def _change_tables(results: Sequence[Result]) -> str:
    text = "rnn, U2, 15 to 20 s\n\n" + _errors(results, "changed", "changed")
    text += "\nz looked up too early by so many ms, twice the error of the one-way delay\n\n"
    text += _errors(results, "offsets", "ms")
    (long,) = of_group(results, "long")
    metrics = long.metrics
    text += (
        f"\n100 s: |W| from 15 to 20 s {metrics['norm_w_low']:.2f} to {metrics['norm_w_high']:.2f};"
        f" from 20 s on {metrics['late_norm_w_low']:.2f} to {metrics['late_norm_w_high']:.2f}"
        f" (.95 to 12.5), rms error there {pair(long, 'late_')}\n"
    )
    return text


def _errors(results: Sequence[Result], group: str, head: str) -> str:
    """Return a row a run of a group."""
    rows = [
        [r.case.label, *bracketed_cells([pair(r)], known(group, r.case.label))]
        for r in of_group(results, group)
    ]
    return markdown((head, "rms error"), rows)


def _losses(results: Sequence[Result]) -> str:
    runs, rows = results_by_run(results, "losses"), []
    for frames in ("U", "TELL_Q", "+".join(UPLINK)):
        for share, burst in LOSSES:
            by_echo, by_delay = (runs["rnn", f"{frames} {share} {burst} {e}"] for e in (1, 0))
            cells = bracketed_cells(
                [_or_end(by_echo), _or_end(by_delay)], known("losses", frames, share, burst)
            )
            held = by_echo.metrics
            rows.append([frames, f"{share:.0%}", str(burst), *cells,
                         f"{held['held_u']:.0f} / {held['held_x']:.0f}"])  # fmt: skip
    head = ("frames", "lost", "burst", "z by echo", "z by delay", "held u / x")
    return "Losses, rnn, U2, 15 to 20 s; bursts in cycles on average\n\n" + markdown(head, rows)


def _or_end(result: Result) -> str:
    return "ended by the supervisor" if result.diverged else pair(result)
