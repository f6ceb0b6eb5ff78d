"""Commands: experiment."""

from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class ExperimentRequest(Request):
    """A study, where it goes, and in how many processes it runs."""

    name: Annotated[
        str,
        "NAME",
        "chapterN of the book, approximation, actuators, drawings, margins, rivals, rough, "
        "theorems, tuning, or a study.py",
    ]
    output: Annotated[str | None, "-o", "DIR", "folder; default: runs/<UTC time>-NAME"] = None
    jobs: Annotated[int | None, "N", "processes; default: one a processor"] = None
    quiet: take.Quiet = False


COMMANDS = (
    Command(
        "experiment",
        "run a study in virtual time: tables and figures",
        "pcpc experiment chapter9 -o results",
        ExperimentRequest,
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
ROOM = Room(
    "docs/book/README.md",
    "tests/tools/cli/test_cli.py",
    "experiment approximation",
    needed_by=("study/book/rivals.py", "study/book/rough.py", "study/margin/book/tuning.py"),
)
