"""Commands: watchdog."""

from typing import Annotated, Literal

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.rooms import Room


class WatchdogRequest(take.RigRequest):
    """A rig, its bus, and what is fed while all is well."""

    bus: Annotated[
        str | None, "INTERFACE[:CHANNEL]", f"{take.BUSES}; the rig's run, if one goes on"
    ] = None
    pacing: Annotated[
        Literal["real", "sync", "lockstep"] | None, "pacing of the run; default: the rig's"
    ] = None
    feed: Annotated[
        str | None, "FILE", "write here as long as all is well: /dev/watchdog, a relay"
    ] = None


COMMANDS = (
    Command(
        "watchdog",
        "watch a run from its bus alone; send the stop frame on a fault",
        "pcpc watchdog hull --bus vcan0 --feed /dev/watchdog",
        WatchdogRequest,
        codes=codes(
            OK="Ctrl-C, nothing was wrong",
            ENVIRONMENT="",
            SAFETY_STOP="the stop frame was sent",
        ),
        notes="RIG needs a supervisor.stop_frame: docs/bus-safety.md",
        judges=True,
        compiles=True,
        module="live.watchdog.serve",
    ),
)
ROOM = Room(
    "docs/bus-safety.md",
    "tests/tools/live/test_watchdog.py",
    "run watched.yaml",
    refused="not in this installation",
    code=4,
)
