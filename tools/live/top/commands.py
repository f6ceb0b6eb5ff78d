"""Commands: top."""

from typing import Annotated

from pcpc.tools.live import arguments as take_live
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import WORD, Request
from pcpc.tools.terminal.rooms import Room


class TopRequest(Request):
    """Which run, and how often."""

    run: Annotated[
        str | None, WORD, "RIG|RUN", "runs of this rig, by name or file, or one run: RIG.BUS"
    ] = None
    node: Annotated[str | None, "NODE", "a node, if several run, or RIG.BUS"] = None
    every_s: Annotated[
        float, take.seconds("--every"), "--every", "TIME", "interval; default: 1s"
    ] = 1.0
    once: Annotated[bool, "print one screen and end"] = False
    elsewhere: take_live.Elsewhere = take_live.Elsewhere()


COMMANDS = (
    Command(
        "top",
        "show a run on one screen: states, faults, timing, frames, parameters",
        "pcpc top\npcpc top hull --once",
        TopRequest,
        notes="q or Ctrl-C quits; after a run it waits for the next",
        module="live.top.cli",
        codes=codes(ENVIRONMENT="--once: no such run", INTERRUPTED=""),
    ),
)
ROOM = Room("docs/howto/terminal.md", "tests/tools/live/test_top.py", "top")
