"""Commands: margin."""

import argparse
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import BASIC_CODES, Add, Command
from pcpc.tools.terminal.rates import frequency


def margin(add: Add) -> None:
    """Take a rig, a loop, the point, what is injected."""
    take.rig(add)
    add("--loop", metavar="SIGNAL", help="the sent signal that closes it; default: the first")
    add(
        "--at",
        type=take.duration,
        dest="at_s",
        metavar="TIME",
        help="hold the reference at what it is at this time of the run; default 0 s",
    )
    add("--settle", type=take.duration, metavar="TIME", help="come to rest first; default 4s")
    add(
        "--method",
        choices=("both", "linearised", "measured"),
        default="both",
        help="default: %(default)s",
    )
    add(
        "--amplitude",
        type=float,
        metavar="A",
        help="most that is injected, in the signal's unit; default: chosen by the error",
    )
    add("--lowest", type=frequency, metavar="F", help="lowest frequency; default: the rate by 4000")
    add(
        "--seed", type=take.seed, default=1, metavar="N", help="of the phases; default: %(default)s"
    )
    add(
        "-o",
        "--output",
        type=Path,
        metavar="DIR",
        help="write margin.json, bode.png and nyquist.png there",
    )
    add(
        "--limit-cycle",
        metavar="GAIN",
        help="tell from which factor of this setting on the rig cycles",
    )
    add(
        "--linear",
        action="append",
        default=[],
        metavar="SETTING",
        help="--limit-cycle: what makes it linear, as --set; default: a linear.yaml there",
    )
    add(
        "--with",
        action="append",
        dest="grown",
        metavar="NAME",
        help="--limit-cycle: which of these come back; default: all but noise",
    )
    add("--factors", type=numbers, metavar="F,...", help="--limit-cycle: runs at these factors")
    take.json(add, "print all, with both responses, as one JSON object")


def numbers(text: str) -> list[float]:
    """Return numbers above 0, with commas between."""
    try:
        found = [float(one) for one in text.split(",")]
    except ValueError:
        found = [0.0]
    if not all(0.0 < one < 1e6 for one in found):
        raise argparse.ArgumentTypeError(f"expected numbers above 0 like 1,1.5,2, got {text!r}")
    return found


COMMANDS = (
    Command(
        "margin",
        "tell how far its loop is from instability: linearised and measured",
        "pcpc margin sin0.5 --controller pd\n"
        "pcpc margin sin0.5 --at 500ms --amplitude 0.2 -o margins",
        margin,
        compiles=True,
        module="study.margin.cli",
        codes={**BASIC_CODES, Exit.ENVIRONMENT: "a package is missing", Exit.INTERRUPTED: ""},
    ),
)
