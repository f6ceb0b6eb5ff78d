"""Commands: bounds."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def bounds(add: Add) -> None:
    """Take a rig or a log, and by which law's theorem it is judged."""
    add("what", metavar="RIG|LOG", help="a rig, which is simulated, or a log")
    add("--controller", metavar="NAME", help="use this controller; default: the rig's")
    take.settings(add, "change a value of the rig")
    add("--as", dest="law_as", metavar="LAW", help="use the theorem of this law")
    add("--plot", type=Path, metavar="FILE", help="draw V, its derivatives, |r|, weights, bounds")
    take.code_of_laws(add)
    take.json(add)
    take.quiet(add)


COMMANDS = (
    Command(
        "bounds",
        "check a run against the theorem of its law: V, V', ultimate bound",
        "pcpc bounds friction-c\npcpc bounds latest --plot bounds.png",
        bounds,
        codes=codes(
            OK="the theorem holds, or none is known",
            NOT_MET="violated",
            LOSS="the log is damaged",
            ENVIRONMENT="a package is missing",
            INTERRUPTED="",
        ),
        judges=True,
        compiles=True,
        reads_logs=True,
        module="study.bounds.bounds",
    ),
)
