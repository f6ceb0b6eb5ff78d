"""What `replay` takes to show one cycle."""

from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class OneCycle(Request):
    """Which cycle of a log is shown."""

    cycle: Annotated[
        int | None,
        "N",
        "show this cycle only, stage by stage, hidden states included",
    ] = None
    time: Annotated[
        float | None, take.time, "TIME", "the same as a time of the run: 1.5, 500ms"
    ] = None


BESIDE_REPLAY = OneCycle
COMMANDS: tuple[Command, ...] = ()
ROOM = Room(
    "docs/howto/run.md",
    "tests/tools/after/step",
    "replay latest --cycle 1",
    refused="no option --cycle",
)
