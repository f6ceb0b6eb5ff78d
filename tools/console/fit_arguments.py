"""What `pcpc fit` takes."""

from pcpc.tools.console import arguments as take
from pcpc.tools.console.command import Add


def fit(add: Add) -> None:
    """Take a rig, a log, and what is to be estimated from which sensors."""
    add("rig", metavar="RIG", help="whose plant is the model: its name (pcpc rigs), or its file")
    add("log", metavar="LOG", help="log file, run folder or latest")
    add("--parameter", action="append", default=[], metavar="NAME[=lo:hi]",
        help="a setting of the plant, BLOCK.NAME, and its bounds; default: those that the plant's "
        "identification.py names")  # fmt: skip
    add("--sensor", action="append", default=[], metavar="NAME",
        help="FRAME.signal, or BLOCK.PORT of the plant's own record; all it sends")  # fmt: skip
    add("--set", action="append", default=[], metavar="NAME=VALUE",
        help="any value of the rig, of the model or where the search starts")  # fmt: skip
    add("-o", "--output", metavar="DIR", help="folder, instead of runs/<UTC time>-fit-<rig>")
    take.json(add, "print the result as one JSON object")
    take.quiet(add)
