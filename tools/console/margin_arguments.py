"""What `pcpc margin` takes."""

import argparse
from pathlib import Path

from pcpc.tools.console.arguments import duration, json, rig
from pcpc.tools.console.command import Add
from pcpc.tools.console.rates import frequency


def numbers(text: str) -> list[float]:
    """Return numbers above 0, with commas between."""
    try:
        found = [float(one) for one in text.split(",")]
    except ValueError:
        found = [0.0]
    if not all(0.0 < one < 1e6 for one in found):
        raise argparse.ArgumentTypeError(f"expected numbers above 0 like 1,1.5,2, got {text!r}")
    return found


def margin(add: Add) -> None:
    """Take a rig, a loop, the point, what is injected."""
    rig(add)
    add("--loop", metavar="SIGNAL", help="the sent signal that closes it; default: the first")
    add("--at", type=duration, dest="at_s", metavar="TIME",
        help="hold the reference at what it is at this time of the run; default 0 s")  # fmt: skip
    add("--settle", type=duration, metavar="TIME", help="come to rest first; default 4s")
    add("--method", choices=("both", "linearised", "measured"), default="both",
        help="default: %(default)s")  # fmt: skip
    add("--amplitude", type=float, metavar="A",
        help="most that is injected, in the signal's unit; default: 2 %% of half its range"
    )  # fmt: skip
    add("--lowest", type=frequency, metavar="F", help="lowest frequency; default: the rate by 4000")
    add("--seed", type=int, default=1, metavar="N", help="of the phases; default: %(default)s")
    add("-o", "--output", type=Path, metavar="DIR",
        help="write margin.json, bode.png and nyquist.png there")  # fmt: skip
    add("--limit-cycle", metavar="GAIN",
        help="tell from which factor of this setting on the rig cycles")  # fmt: skip
    add("--linear", action="append", default=[], metavar="SETTING",
        help="--limit-cycle: what makes it linear, as --set; default: a linear.yaml there"
    )  # fmt: skip
    add("--with", action="append", dest="grown", metavar="NAME",
        help="--limit-cycle: which of these come back; default: all but noise")  # fmt: skip
    add("--factors", type=numbers, metavar="F,...", help="--limit-cycle: runs at these factors")
    json(add, "print all, with both responses, as one JSON object")
