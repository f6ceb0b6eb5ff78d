"""What the commands about running nodes take; imports nothing that takes time."""

from argparse import SUPPRESS
from collections.abc import Callable

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add


def table(names: str, count: str | int) -> Callable[[Add], None]:
    """Return what takes `count` variables of a node, called `names`."""

    def arguments(add: Add) -> None:
        add("names", nargs=count, metavar=names)
        add(
            "--node",
            metavar="NODE",
            help="executive, plant, RIG or RIG.plant; default: the one that has NAME",
        )
        at(add)
        take.json(add, "print JSON")

    return arguments


def node(add: Add) -> None:
    """Take one of several nodes."""
    add("--node", metavar="NODE", help="executive, plant, RIG, RIG.plant or a full name")
    at(add)


def at(add: Add) -> None:
    """Take what once asked another machine, and is answered with what does so now."""
    add("--at", dest="elsewhere", help=SUPPRESS)
    add("--token-file", dest="elsewhere_token", help=SUPPRESS)
    add("--ca", dest="elsewhere_ca", help=SUPPRESS)
    add("--plain", dest="elsewhere_plain", action="store_true", help=SUPPRESS)
