"""Commands: bounds."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class BoundsRequest(Request):
    """A rig or a log, and by which law's theorem it is judged."""

    what: Annotated[str, "RIG|LOG", "a rig, which is simulated, or a log"]
    controller: Annotated[str | None, "NAME", "use this controller; default: the rig's"] = None
    set: Annotated[Sequence[str], "NAME=VALUE", "change a value of the rig"] = ()
    law_as: Annotated[str | None, "--as", "LAW", "use the theorem of this law"] = None
    plot: Annotated[Path | None, "FILE", "draw V, its derivatives, |r|, weights, bounds"] = None
    code: take.CodeOfLaws = take.CodeOfLaws()
    json: take.Json = False
    quiet: take.Quiet = False


COMMANDS = (
    Command(
        "bounds",
        "check a run against the theorem of its law: V, V', ultimate bound",
        "pcpc bounds friction-c\npcpc bounds latest --plot bounds.png",
        BoundsRequest,
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
ROOM = Room("docs/theorems.md", "tests/tools/study/test_bounds.py", "bounds probe")
