"""Commands: experiment."""

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def experiment(add: Add) -> None:
    """Take a study."""
    add(
        "name",
        metavar="NAME",
        help="chapterN of the book, approximation, actuators, drawings, margins, rivals, rough, "
        "theorems, tuning, or a study.py",
    )
    add("-o", "--output", metavar="DIR", help="folder; default: runs/<UTC time>-NAME")
    add("--jobs", type=int, metavar="N", help="processes; default: one a processor")
    take.quiet(add)


COMMANDS = (
    Command(
        "experiment",
        "run a study in virtual time: tables and figures",
        "pcpc experiment chapter9 -o results",
        experiment,
        codes=codes(
            NOT_MET="a run failed",
            LOSS="",
            ENVIRONMENT="",
            INTERRUPTED="",
        ),
        judges=True,
        compiles=True,
        module="study.experiment.cli",
    ),
)
