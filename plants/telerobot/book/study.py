"""The study of the telerobot: three scenarios, six controllers, delays, losses, wrong models.

Figures are rms errors of joint 1 / joint 2; in brackets, beside each, what an independent
implementation of the same equations gave.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from pcpc.plants.book.tables import (
    Column,
    RunsTable,
    Sentence,
    across,
    at,
    by_label,
    case_maker,
    controller_of,
    expected_figures,
    label_of,
    page,
    part,
    recorded,
    rig_name,
)
from pcpc.plants.study import Case, CaseResult
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


def error(part: str = "") -> Callable[[CaseResult], str]:
    """Return what gives the rms errors of both joints; STOPPED where a joint tripped."""

    def text(result: CaseResult) -> str:
        if "tripped_s" in result.metrics:
            return STOPPED
        values = [result.metrics.get(f"{part}error_rms_{j}_rad", float("nan")) for j in (1, 2)]
        return " / ".join(f"{value:.4f}".removeprefix("0") for value in values)

    return text


def error_or_end(result: CaseResult) -> str:
    """Return the rms errors of both joints of a run that was not ended."""
    return "ended by the supervisor" if result.diverged else error()(result)


def held(result: CaseResult) -> str:
    """Return the cycles without a frame, of either way."""
    return "{held_u:.0f} / {held_x:.0f}".format_map(result.metrics)


def lost(result: CaseResult) -> str:
    """Return the share of frames that are lost."""
    return f"{float(label_of(result).split()[1]):.0%}"


ERROR = Column("rms error", error())
NORMS = ("norm_w_low", "norm_w_high", "late_norm_w_low", "late_norm_w_high")
TABLES = (
    "rms error of joint 1 / joint 2, rad, against the reference of T ago; in brackets the "
    "figures of an independent implementation of the same equations. Unstable: a joint "
    "came to 20 rad/s and the robot's node stopped the arm.\n",
    RunsTable(
        "scenarios",
        (
            *across(label_of, {"u0": "U0", "u1": "U1"}, Column("{}, 15 to 20 s", error())),
            *at(
                label_of, "u2", Column("U2, 5 to 10 s", error("before_")),
                Column("U2, 10 to 15 s", error("load_")), Column("U2, 15 to 20 s", error()),
            ),
        ),
        "Scenarios, T = 0.2 s",
        {"": controller_of},
    ),
    RunsTable(
        "delays",
        across(controller_of, DELAYED, Column("{}", error())),
        "Delay, U2, 15 to 20 s",
        {"T [s]": label_of},
    ),
    RunsTable(
        "limit",
        across(rig_name, {"telerobot-u0": "U0", "telerobot-u1": "U1"}, Column("{}", error())),
        "pd_match at its limit of 0.044 s, 15 to 20 s",
        {"T [s]": label_of},
    ),
    RunsTable("changed", [ERROR], "rnn, U2, 15 to 20 s", {"changed": label_of}),
    RunsTable(
        "offsets",
        [ERROR],
        "z looked up too early by so many ms, twice the error of the one-way delay",
        {"ms": label_of},
    ),
    Sentence(
        "long",
        [*(Column("", recorded(n), text="{:.2f}") for n in NORMS), Column("", error("late_"))],
        "100 s: |W| from 15 to 20 s {} to {}; from 20 s on {} to {} (.95 to 12.5), rms error there"
        " {}\n",
    ),
    RunsTable(
        "losses",
        (
            *across(part(-1), {1: "echo", 0: "delay"}, Column("z by {}", error_or_end)),
            *at(part(-1), 1, Column("held u / x", held)),
        ),
        "Losses, rnn, U2, 15 to 20 s; bursts in cycles on average",
        {"frames": part(0, " ", 3), "lost": lost, "burst": part(2, " ", 3)},
    ),
)  # fmt: skip


def report(results: Sequence[CaseResult]) -> str:
    """Return the tables."""
    return page(results, TABLES, known)


def draw(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw the default scenario, and errors over delay, wrong delay and bursts."""
    draw_all(results, by_label(results, "losses"), BURSTS, folder)
