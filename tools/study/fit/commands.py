"""Commands: fit."""

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def fit(add: Add) -> None:
    """Take a rig, a log, and what is to be estimated from which sensors."""
    add("rig", metavar="RIG", help="the rig whose plant is the model: name or file")
    take.log(add)
    take.several(
        add,
        "--parameter",
        "NAME[=lo:hi]",
        "a setting of the plant, BLOCK.NAME, and its bounds; default: those of the plant's "
        "identification.py",
    )
    take.several(
        add,
        "--sensor",
        "NAME",
        "FRAME.signal, or BLOCK.PORT in the plant's record; default: all sent",
    )
    take.settings(add, "change a value of the model, or a start of the search")
    add("-o", "--output", metavar="DIR", help="folder; default: runs/<UTC time>-fit-<rig>")
    take.json(add)
    take.quiet(add)


COMMANDS = (
    Command(
        "fit",
        "estimate plant parameters from a log, with 95 % intervals",
        "pcpc fit slew10 latest\n"
        "pcpc fit slew10 latest --parameter barrel.gap_rad=0:0.01 -o fitted\n"
        "pcpc simulate slew10 --set @fitted/fit.yaml",
        fit,
        judges=True,
        compiles=True,
        reads_logs=True,
        module="study.fit.cli",
        codes=codes(
            NOT_MET="the log does not determine a --parameter, or no parameter at all",
            LOSS="the log is damaged",
            ENVIRONMENT="a package is missing",
            INTERRUPTED="",
        ),
    ),
)
