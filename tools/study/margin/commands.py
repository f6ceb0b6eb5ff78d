"""Commands: margin."""

import argparse

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes
from pcpc.tools.terminal.rates import frequency


def margin(add: Add) -> None:
    """Take a rig, a loop, the point, what is injected."""
    take.rig(add)
    add(
        "--loop",
        metavar="SIGNAL",
        help="the command signal that closes the loop; default: the first",
    )
    add(
        "--at",
        type=take.duration,
        default=0.0,
        dest="at_s",
        metavar="TIME",
        help="hold the reference of this time of the run; default: 0 s",
    )
    add(
        "--settle",
        type=take.duration,
        default="4s",
        metavar="TIME",
        help="time to come to rest; default: %(default)s",
    )
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
        help="injected amplitude, in the signal's unit; default: automatic",
    )
    add("--lowest", type=frequency, metavar="F", help="lowest frequency; default: rate/4000")
    add(
        "--seed",
        type=take.seed,
        default=1,
        metavar="N",
        help="seed of the phases; default: %(default)s",
    )
    add(
        "-o",
        "--output",
        metavar="DIR",
        help="folder for margin.json, bode.png and nyquist.png",
    )
    add(
        "--limit-cycle",
        metavar="GAIN",
        help="predict the factor of this setting where a limit cycle begins",
    )
    take.several(
        add,
        "--linear",
        "SETTING",
        "--limit-cycle: makes it linear, as --set; default: its linear.yaml",
    )
    add(
        "--with",
        action="append",
        dest="grown",
        metavar="NAME",
        help="--limit-cycle: nonlinearities to restore; default: all but noise",
    )
    add("--factors", type=numbers, metavar="F,...", help="--limit-cycle: also run at these factors")
    take.json(add)


def numbers(text: str) -> list[float]:
    """Return numbers above 0, with commas between. ArgumentTypeError: not such numbers."""
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
        "compute and measure the stability margins of a rig's loop",
        "pcpc margin sin0.5 --controller pd\n"
        "pcpc margin sin0.5 --at 500ms --amplitude 0.2 -o margins",
        margin,
        compiles=True,
        module="study.margin.cli",
        codes=codes(ENVIRONMENT="a package is missing", INTERRUPTED=""),
    ),
)
