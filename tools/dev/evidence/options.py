"""The options of `python -m pcpc.tools.dev.evidence`, and of `.evidence.soak`."""

import argparse
import math

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes

PARTS = ("matrix", "residual", "frames", "envelope", "alarms", "mutants", "kills")  # in their order
_MOST_H = 87_600.0  # ten years


def evidence(add: Add) -> None:
    """Take the parts of the evidence, how much of each, and where it goes."""
    add("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all")
    add(
        "--runs",
        type=take.positive,
        default=3000,
        metavar="N",
        help="runs of each fault; default: 3000",
    )
    add(
        "--hours",
        type=hours,
        default=100.0,
        metavar="H",
        help="hours without a fault; default: 100",
    )
    add(
        "--frames",
        type=take.positive,
        default=1_000_000,
        metavar="N",
        help="damaged frames; default: 10^6",
    )
    add(
        "--laws",
        type=take.positive,
        default=100_000,
        metavar="N",
        help="random laws; default: 100,000",
    )
    add(
        "--kills",
        type=take.positive,
        default=100,
        metavar="N",
        help="disturbed processes; default: 100",
    )
    add("--seed", type=take.seed, default=1, metavar="N", help="first seed; default: 1")
    add("-j", "--jobs", type=take.positive, metavar="N", help="processes; default: one a processor")
    add(
        "-o",
        "--output",
        default="evidence",
        metavar="FOLDER",
        help="folder for faults.md and faults.json",
    )
    take.quiet(add, "-q")


def hours(text: str) -> float:
    """Return a number of hours above 0."""
    try:
        found = float(text)
    except ValueError:
        found = math.nan
    if not 0.0 < found <= _MOST_H:
        what = f"expected hours, above 0 and at most {_MOST_H:g}, got {text!r}"
        raise argparse.ArgumentTypeError(what)
    return found


def soak(add: Add) -> None:
    """Take a rig and for how long."""
    add("rig", metavar="RIG", help="a rig's name (pcpc rigs) or file")
    add("--hours", type=hours, default=1.0, metavar="H", help="default: %(default)s")
    add(
        "--each",
        type=take.duration,
        default=600.0,
        metavar="DURATION",
        help="duration of a run on a clock; default: 10min",
    )
    add(
        "--seed",
        type=take.seed,
        default=1,
        metavar="N",
        help="seed of tunings and faults; default: %(default)s",
    )
    take.json(add, "print JSON, a line a run")
    take.quiet(add, "-q")


COMMAND = Command(
    "pcpc.tools.dev.evidence",
    "inject every fault and count what detects it",
    "python -m pcpc.tools.dev.evidence\npython -m pcpc.tools.dev.evidence mutants kills --kills 32",
    evidence,
    compiles=True,
    module="dev.evidence.native_process",
    codes=codes(
        OK="all figures as stated",
        NOT_MET="a figure is not as stated",
        ENVIRONMENT="cannot be written",
        INTERRUPTED="",
    ),
)
SOAK = Command(
    "pcpc.tools.dev.evidence.soak",
    "run with random tunings and faults for hours; check each log",
    "python -m pcpc.tools.dev.evidence.soak hull --hours 8",
    soak,
    compiles=True,
    module="dev.evidence.soak",
    codes=codes(
        OK="no problem",
        NOT_MET="a log has a problem",
        INTERRUPTED="",
    ),
)
