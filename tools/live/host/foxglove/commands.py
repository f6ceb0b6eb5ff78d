"""What `pcpc host` takes for Foxglove and Lichtblick."""

import argparse
from typing import Annotated

from pcpc.tools.terminal.command import Command
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


def port(text: str) -> int:
    """Return a port; 0: any that is free. ArgumentTypeError: not a port."""
    if not text.isdecimal() or int(text) > 65535:
        what = f"{text!r} is not a port; the rig comes first: `pcpc host {text} --foxglove`"
        raise argparse.ArgumentTypeError(what)
    return int(text)


class FoxgloveRequest(Request):
    """Whether they are served, or a layout is printed."""

    foxglove: Annotated[
        int | None,
        port,
        "PORT",
        "serve Foxglove and Lichtblick; default: first free port from 8765",
        {"nargs": "?", "const": -1},
    ] = None
    foxglove_layout: Annotated[bool, "print a layout of RIG for both"] = False


BESIDE_HOST = FoxgloveRequest
COMMANDS: tuple[Command, ...] = ()
ROOM = Room(
    "docs/howto/foxglove.md",
    "tests/tools/live/host/test_foxglove.py",
    "host --foxglove",
    refused="no option --foxglove",
)
