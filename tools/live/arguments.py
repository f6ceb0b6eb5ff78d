"""What the commands about running nodes take; imports nothing that takes time."""

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
    """Take on which other machine the nodes run."""
    add("--at", metavar="HOST:PORT", help="nodes of another machine, through its `pcpc host`")
    add(
        "--token-file",
        metavar="FILE",
        help="--at: file with its token; default: PCPC_TOKEN",
    )
    add("--ca", metavar="FILE", help="--at: the host's own certificate (PEM)")
    add(
        "--plain", action="store_true", help="--at: no TLS: anyone on the network can read and tune"
    )
