"""Commands: bisect."""

from collections.abc import Sequence
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class BisectRequest(Request):
    """A rig, and two commits of the repository that holds it."""

    rig: Annotated[str, "RIG", "a rig's name (pcpc rigs), file or folder"]
    good: Annotated[str, "GOOD", "git revision with the wanted bits"]
    bad: Annotated[str, "BAD", "later git revision whose bits differ"]
    controller: Annotated[str | None, "NAME", "use this controller; default: the rig's"] = None
    set: Annotated[
        Sequence[str],
        "NAME=VALUE",
        "change a value of every run, as duration_s=2; @FILE: from pcpc save",
    ] = ()
    duration: Annotated[
        float | None, take.duration, "DURATION", "length of the runs; default: the rig's"
    ] = None
    json: take.Json = False
    quiet: take.Quiet = False


COMMANDS = (
    Command(
        "bisect",
        "find the commit, cycle and signal that first changed the bits of a run",
        "pcpc bisect hull v1.2 HEAD\npcpc bisect step10 HEAD~9 HEAD --controller pid --duration 2s",
        BisectRequest,
        notes="The commits of the repository that holds RIG run in virtual time, in a folder\n"
        "of their own: only test commits whose code you would run. If the repository\n"
        "is that of pcpc, its code comes from the commit, too.",
        judges=True,
        module="after.bisect.cli",
        codes=codes(
            OK="found",
            NOT_MET="equal bits, or several commits are left",
            LOSS="a disk is full",
            ENVIRONMENT="git is missing",
            INTERRUPTED="",
        ),
    ),
)
ROOM = Room("docs/howto/ci.md", "tests/tools/after/bisect", "bisect hull a b")
