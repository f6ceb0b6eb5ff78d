"""Commands: fit."""

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command


def fit(add: Add) -> None:
    """Take a rig, a log, and what is to be estimated from which sensors."""
    add("rig", metavar="RIG", help="whose plant is the model: its name (pcpc rigs), or its file")
    add("log", metavar="LOG", help="log file, run folder or latest")
    add(
        "--parameter",
        action="append",
        default=[],
        metavar="NAME[=lo:hi]",
        help="a setting of the plant, BLOCK.NAME, and its bounds; default: those that the plant's "
        "identification.py names",
    )
    add(
        "--sensor",
        action="append",
        default=[],
        metavar="NAME",
        help="FRAME.signal, or BLOCK.PORT of the plant's own record; all it sends",
    )
    add(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any value of the rig, of the model or where the search starts",
    )
    add("-o", "--output", metavar="DIR", help="folder, instead of runs/<UTC time>-fit-<rig>")
    take.json(add, "print the result as one JSON object")
    take.quiet(add)


COMMANDS = (
    Command(
        "fit",
        "estimate parameters of the plant from a log, with 95 % intervals",
        "pcpc fit slew10 latest\n"
        "pcpc fit slew10 latest --parameter barrel.gap_rad=0:0.01 -o fitted\n"
        "pcpc simulate slew10 --set @fitted/fit.yaml",
        fit,
        judges=True,
        compiles=True,
        reads_logs=True,
        module="study.fit.cli",
        codes={
            Exit.OK: "",
            Exit.NOT_MET: "the log tells nothing of a --parameter, or of all",
            Exit.WRONG_INPUT: "",
            Exit.LOSS: "the log is damaged",
            Exit.ENVIRONMENT: "a package is missing",
            Exit.INTERRUPTED: "",
        },
    ),
)
