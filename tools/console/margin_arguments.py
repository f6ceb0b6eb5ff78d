"""What `pcpc margin` takes."""

from pathlib import Path

from pcpc.tools.console.arguments import duration, json, rig
from pcpc.tools.console.command import Add
from pcpc.tools.console.rates import frequency


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
    json(add, "print all, with both responses, as one JSON object")
