"""Commands: evidence, soak."""

import argparse
import math

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command

PARTS = ("matrix", "residual", "frames", "envelope", "alarms", "mutants", "kills")  # in their order
_MOST_H = 87_600.0  # ten years


def evidence(add: Add) -> None:
    """Take the parts of the evidence, how much of each, and where it goes."""
    add("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all")
    add("--runs", type=take.positive, default=3000, metavar="N", help="of each fault; 3000")
    add("--hours", type=hours, default=100.0, metavar="H", help="without a fault; 100")
    add("--frames", type=take.positive, default=1_000_000, metavar="N", help="damaged frames; 10^6")
    add("--laws", type=take.positive, default=100_000, metavar="N", help="random ones; 100,000")
    add("--kills", type=take.positive, default=100, metavar="N", help="disturbed processes; 100")
    add("--seed", type=take.seed, default=1, metavar="N", help="the first of the seeds; 1")
    add("-j", "--jobs", type=take.positive, metavar="N", help="processes; as many as processors")
    add("-o", "--output", default="evidence", metavar="FOLDER", help="for faults.md, faults.json")
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
    add("rig", metavar="RIG", help="rig file, or the name of one that comes with pcpc")
    add("--hours", type=hours, default=1.0, metavar="H", help="default: %(default)s")
    add("--each", type=take.duration, default=600.0, metavar="DURATION",
        help="of a run on a clock; 10min")  # fmt: skip
    add("--seed", type=take.seed, default=1, metavar="N", help="of what is drawn; %(default)s")
    take.json(add, "print a row a run as JSON")
    take.quiet(add, "-q")


COMMANDS = (
    Command(
        "evidence",
        "inject every fault, count what notices it, write a page of all",
        "pcpc evidence\npcpc evidence mutants kills --kills 32",
        evidence,
        compiles=True,
        module="dev.evidence.native_process",
        codes={
            Exit.OK: "all as stated",
            Exit.NOT_MET: "something was not",
            Exit.WRONG_INPUT: "",
            Exit.ENVIRONMENT: "the folder cannot be written",
            Exit.INTERRUPTED: "",
        },
    ),
    Command(
        "soak",
        "run after run with other tunings and faults for hours; check each log",
        "pcpc soak hull --hours 8",
        soak,
        compiles=True,
        module="dev.evidence.soak",
        codes={
            Exit.OK: "nothing wrong",
            Exit.NOT_MET: "a log was",
            Exit.WRONG_INPUT: "",
            Exit.INTERRUPTED: "",
        },
    ),
)
