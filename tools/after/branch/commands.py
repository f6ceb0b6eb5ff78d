"""Commands: branch."""

from collections.abc import Sequence
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class BranchRequest(Request):
    """A log, a cycle, and what is different from there on."""

    log: take.Log
    cycle: Annotated[int | None, "N", "first cycle that is different, of the executive"] = None
    time: Annotated[
        float | None, take.time, "TIME", "the same as a time of the run: 1.5, 500ms"
    ] = None
    set: Annotated[
        Sequence[str],
        "NAME=VALUE",
        "set a parameter there, as controller.kv_Nms_rad=130; NODE:NAME=VALUE "
        "where several nodes have it",
    ] = ()
    controller: Annotated[str | None, "NAME", "hand over to this controller there"] = None
    fault: Annotated[
        Sequence[str],
        "NAME[:DURATION]",
        "begin a fault of the rig there; default duration: to the end",
    ] = ()
    duration_s: Annotated[
        float | None,
        take.duration,
        "--duration",
        "DURATION",
        "length of the whole run; default: as the log's rig",
    ] = None
    bus: Annotated[
        str | None,
        "INTERFACE[:CHANNEL]",
        "go on over this bus in lockstep, auto: a free one; default: none",
    ] = None
    code: take.CodeOfLaws = take.CodeOfLaws()
    kept: take.RunFolder = take.RunFolder()


COMMANDS = (
    Command(
        "branch",
        "continue a recorded run with a change from a cycle on, in closed loop",
        "pcpc branch latest --cycle 4000 --set controller.kv_Nms_rad=130\n"
        "pcpc branch latest --time 2 --controller pid --duration 20s",
        BranchRequest,
        notes="All nodes continue in virtual time. The new run is complete from cycle 0.\n"
        "Without a change the branch is bit-identical to a virtual or lockstep log.",
        judges=True,
        compiles=True,
        reads_logs=True,
        module="after.branch.cli",
    ),
)
ROOM = Room("docs/howto/branch.md", "tests/tools/after/branch", "branch latest")
