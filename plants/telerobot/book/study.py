"""The study of the telerobot: three scenarios, six controllers, delays, losses, wrong models.

Figures are rms errors of joint 1 / joint 2; in brackets, beside each, what an independent
implementation of the same equations gave.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from pcpc.plants.study import Case, Result, markdown, of_group

CHAPTER = 8
TITLE = "Chapter 8: a telerobot behind a delay"
RIGS = Path(__file__).resolve().parents[1] / "rigs"
CONTROLLERS = ("pd_near", "pd", "pd_match", "pd_slow", "smith", "nornn", "rnn")
DRAWN = ("pd_near", "pd_slow", "smith", "nornn", "rnn")
DELAYS_S = (0.1, 0.2, 0.3, 0.4, 0.5)
LIMIT_S = (0.04, 0.044, 0.046, 0.05)
BURSTS = (1, 5, 20)
UPLINK = ("TELL_Q", "TELL_V", "ECHO")
TRACES = (
    "executive:controller.aim_1_rad", "executive:controller.aim_2_rad",
    "plant:arm.q_1_rad", "plant:arm.q_2_rad", "error_1_rad", "error_2_rad",
)  # fmt: skip
STOPPED = "unstable"

KNOWN = {  # U0 [15, 20], U1 [15, 20], U2 [5, 10), [10, 15), [15, 20]
    "pd_near": (".0001 / .0002", ".1172 / .2363", ".1224 / .2847", ".0611 / .2649",
                ".1146 / .2666"),
    "pd": ("diverges", "diverges", "diverges", "diverges", "diverges"),
    "pd_match": ("diverges", "diverges", "diverges", "diverges", "diverges"),
    "pd_slow": (".0031 / .0057", ".651 / .543", ".540 / .603", ".674 / .566", ".490 / .561"),
    "smith": (".0002 / .0003", ".1440 / .2983", ".1687 / .3953", ".0884 / .3595", ".1441 / .3486"),
    "nornn": (".0209 / .0399", ".0394 / .0779", ".0257 / .0584", ".0209 / .0609", ".0331 / .0679"),
    "rnn": (".0010 / .0021", ".0019 / .0039", ".0013 / .0027", ".0020 / .0048", ".0015 / .0033"),
}  # fmt: skip
KNOWN_DELAY = {
    ("smith", "0.1"): ".128 / .302", ("rnn", "0.1"): ".0013 / .0025",
    ("smith", "0.2"): ".1441 / .3486", ("rnn", "0.2"): ".0015 / .0033",
    ("nornn", "0.2"): ".0331 / .0679",
    ("smith", "0.5"): ".161 / .417", ("rnn", "0.5"): ".0021 / .0047",
}  # fmt: skip
SAME = ".0015 / .0033"
CHANGED: dict[str, tuple[tuple[str, ...], str]] = {
    "as it is": ((), SAME),
    **{f"torque {d} samples old": ((f"arm.delay_samples={d}.0",), SAME) for d in range(1, 6)},
    "q 2e-4 rad, q' 1e-3 rad/s": (("arm.position_lsb_rad=2e-4", "arm.rate_lsb_rad_s=1e-3"), SAME),
    "u 0.01 rad/s2": (("controller.u_lsb_rad_s2=0.01",), ""),
    "u 1 rad/s2": (("controller.u_lsb_rad_s2=1.0",), ""),
    "torque 0.1 N m": (("arm.torque_lsb_Nm=0.1",), ""),
    "torque 1 N m": (("arm.torque_lsb_Nm=1.0",), ""),
    "20 integration steps": (("arm.substeps=20.0",), SAME),
    "kap 1": (("servo.kap=1.0",), ".0219 / .0456"),
    "kap 10": (("servo.kap=10.0",), ".0314 / .0646"),
}
OFFSETS = {  # ticks by which z is looked up too early
    -40: ".0138 / .0169", -10: ".0025 / .0042", -2: ".0010 / .0031", -1: ".0012 / .0032",
    0: SAME, 1: ".0018 / .0036", 2: ".0022 / .0038", 10: ".0051 / .0066", 40: ".0159 / .0191",
}  # fmt: skip
KNOWN_LOSS = {("U", 0.01, 1): SAME, ("U", 0.1, 1): ".0016 / .0034"}


def _case(
    group: str, rig: str, controller: str, label: str, *settings: str, traces: tuple[str, ...] = ()
) -> Case:
    file = str(RIGS / f"telerobot-{rig}.yaml")
    return Case(group, file, controller, label, settings, traces=traces)


def cases() -> Iterator[Case]:
    """Yield all runs of the study."""
    for rig in ("u0", "u1", "u2"):
        for controller in CONTROLLERS:
            drawn = TRACES if rig == "u2" and controller in DRAWN else ()
            yield _case("scenarios", rig, controller, rig, traces=drawn)
    for delay in DELAYS_S:
        for controller in ("pd", "smith", "nornn", "rnn"):
            yield _case("delays", "u2", controller, str(delay), f"controller.delay_s={delay}")
    for rig in ("u0", "u1"):
        for delay in LIMIT_S:
            yield _case("limit", rig, "pd_match", str(delay), f"controller.delay_s={delay}")
    for label, (settings, _) in CHANGED.items():
        yield _case("changed", "u2", "rnn", label, *settings)
    for offset in OFFSETS:
        setting = f"controller.history_offset_ticks={offset}.0"
        yield _case("offsets", "u2", "rnn", str(offset), setting)
    for echo in (1, 0):
        for frames in (("U",), ("TELL_Q",), UPLINK):
            yield from _lossy(echo, frames)
    yield _case("long", "u2", "rnn", "100 s", "duration_s=100.0")


def _lossy(echo: int, frames: Sequence[str]) -> Iterator[Case]:
    for share, burst in ((0.01, 1), *((0.1, burst) for burst in BURSTS)):
        settings = [f"controller.use_echo={echo}.0"]
        for frame in frames:
            settings += [f"losses.{frame}.share={share}", f"losses.{frame}.burst={burst}.0"]
        label = f"{'+'.join(frames)} {share} {burst} {echo}"
        yield _case("losses", "u2", "rnn", label, *settings)


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw the default scenario, and errors over delay, wrong delay and bursts."""
    from pcpc.plants.telerobot.book.study_figures import draw_all

    draw_all(results, found(results, "losses"), BURSTS, folder)


def pair(result: Result, part: str = "") -> str:
    """Return the rms errors of both joints; STOPPED where a joint tripped."""
    if "tripped_s" in result.metrics:
        return STOPPED
    values = [result.metrics.get(f"{part}error_rms_{j}_rad", float("nan")) for j in (1, 2)]
    return " / ".join(f"{value:.4f}".removeprefix("0") for value in values)


def found(results: Sequence[Result], group: str) -> Mapping[tuple[str, str], Result]:
    """Return the results of a group by (controller, label)."""
    return {(r.case.controller, r.case.label): r for r in of_group(results, group)}


def _beside(measured: str, other: str) -> str:
    return f"{measured} ({other})" if other else measured


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    return "\n".join(
        (
            "rms error of joint 1 / joint 2, rad, against the reference of T ago; in brackets the "
            "figures of an independent implementation of the same equations. Unstable: a joint "
            "came to 20 rad/s and the robot's node stopped the arm.\n",
            _scenarios(results),
            _delays(results),
            _changed(results),
            _losses(results),
        )
    )


def _scenarios(results: Sequence[Result]) -> str:
    runs, rows = found(results, "scenarios"), []
    for controller in CONTROLLERS:
        u0, u1, u2 = (runs[controller, rig] for rig in ("u0", "u1", "u2"))
        cells = (pair(u0), pair(u1), pair(u2, "before_"), pair(u2, "load_"), pair(u2))
        rows.append([controller, *map(_beside, cells, KNOWN[controller])])
    head = ("", "U0, 15 to 20 s", "U1, 15 to 20 s", "U2, 5 to 10 s", "U2, 10 to 15 s",
            "U2, 15 to 20 s")  # fmt: skip
    return "Scenarios, T = 0.2 s\n\n" + markdown(head, rows)


def _delays(results: Sequence[Result]) -> str:
    runs = found(results, "delays")
    controllers = ("pd", "smith", "nornn", "rnn")
    rows = [
        [str(d), *(_beside(pair(runs[c, str(d)]), KNOWN_DELAY.get((c, str(d)), ""))
                   for c in controllers)]
        for d in DELAYS_S
    ]  # fmt: skip
    text = "Delay, U2, 15 to 20 s\n\n" + markdown(("T [s]", *controllers), rows)
    limits = {(Path(r.case.rig).stem[-2:], r.case.label): r for r in of_group(results, "limit")}
    rows = [[str(d), pair(limits["u0", str(d)]), pair(limits["u1", str(d)])] for d in LIMIT_S]
    text += "\npd_match at its limit of 0.044 s, 15 to 20 s\n\n"
    return text + markdown(("T [s]", "U0", "U1"), rows)


def _changed(results: Sequence[Result]) -> str:
    runs = found(results, "changed")
    rows = [
        [label, _beside(pair(runs["rnn", label]), other)] for label, (_, other) in CHANGED.items()
    ]
    text = "rnn, U2, 15 to 20 s\n\n" + markdown(("changed", "rms error"), rows)
    runs = found(results, "offsets")
    rows = [[str(d), _beside(pair(runs["rnn", str(d)]), other)] for d, other in OFFSETS.items()]
    text += "\nz looked up too early by so many ms, twice the error of the one-way delay\n\n"
    text += markdown(("ms", "rms error"), rows)
    metrics = found(results, "long")["rnn", "100 s"].metrics
    text += (
        f"\n100 s: |W| from 15 to 20 s {metrics['norm_w_low']:.2f} to {metrics['norm_w_high']:.2f};"
        f" from 20 s on {metrics['late_norm_w_low']:.2f} to {metrics['late_norm_w_high']:.2f}"
        f" (.95 to 12.5), rms error there {pair(found(results, 'long')['rnn', '100 s'], 'late_')}\n"
    )
    return text


def _losses(results: Sequence[Result]) -> str:
    rows = []
    runs = found(results, "losses")
    for frames in ("U", "TELL_Q", "+".join(UPLINK)):
        for share, burst in ((0.01, 1), *((0.1, burst) for burst in BURSTS)):
            by_echo, by_delay = (runs["rnn", f"{frames} {share} {burst} {e}"] for e in (1, 0))
            row = [frames, f"{share:.0%}", str(burst)]
            row.append(_beside(_or_end(by_echo), KNOWN_LOSS.get((frames, share, burst), "")))
            row.append(_or_end(by_delay))
            held = by_echo.metrics
            rows.append([*row, f"{held['held_u']:.0f} / {held['held_x']:.0f}"])
    head = ("frames", "lost", "burst", "z by echo", "z by delay", "held u / x")
    return "Losses, rnn, U2, 15 to 20 s; bursts in cycles on average\n\n" + markdown(head, rows)


def _or_end(result: Result) -> str:
    return "ended by the supervisor" if result.diverged else pair(result)
