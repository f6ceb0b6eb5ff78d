"""What `pcpc host` takes for Foxglove and Lichtblick."""

import argparse

from pcpc.tools.terminal.command import Add, Command


def foxglove_options(add: Add) -> None:
    """Take whether they are served, or a layout is printed."""
    add(
        "--foxglove",
        type=port,
        nargs="?",
        const=-1,
        metavar="PORT",
        help="serve Foxglove and Lichtblick; default: first free port from 8765",
    )
    add("--foxglove-layout", action="store_true", help="print a layout of RIG for both")


def port(text: str) -> int:
    """Return a port; 0: any that is free. ArgumentTypeError: not a port."""
    if not text.isdecimal() or int(text) > 65535:
        what = f"{text!r} is not a port; the rig comes first: `pcpc host {text} --foxglove`"
        raise argparse.ArgumentTypeError(what)
    return int(text)


BESIDE_HOST = foxglove_options
COMMANDS: tuple[Command, ...] = ()
