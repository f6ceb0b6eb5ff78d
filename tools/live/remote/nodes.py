"""The running nodes that a command is about: of this machine, or with --at of another one.

What asks another machine is imported only then, as it takes time.
"""

import argparse

from pcpc.drivers.errors import Exit
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.tools.live.local_nodes import Nodes
from pcpc.tools.start import rigs
from pcpc.tools.terminal.option_notes import refuse


def nodes_of(options: argparse.Namespace) -> Nodes:
    """Return where the nodes of a command are; UserError."""
    if getattr(options, "at", None) is None:
        refuse(options, "only with --at HOST:PORT", "token_file", "ca", "plain")
        return Nodes()
    from pcpc.tools.live.remote.link import Link  # numba
    from pcpc.tools.live.remote.live import RemoteNodes

    if getattr(options, "link", None) is None:
        options.link = Link(options)
    return RemoteNodes(options.link)


def leader(there: Nodes, rig: str, node: str = "executive") -> Live:
    """Return the node that is meant of a rig's run, "" for any rig; LiveError with what runs."""
    found = there.running(rig) if rig else {}
    if rig and not found:
        runs = sorted({str(one.block.description["rig"]) for one in there.running().values()})
        instead = f"there are runs of {', '.join(runs)}" if runs else "`pcpc run RIG` starts one"
        raise LiveError(f"{rig}: no run of this rig; {instead}", Exit.ENVIRONMENT)
    runs = sorted({one.run for one in found.values()})
    if len(runs) > 1 and node == "executive":
        raise LiveError(f"{rig}: {len(runs)} runs of this rig; choose {' or '.join(runs)}")
    return there.find(node, rig)


def rig_of(options: argparse.Namespace, there: Nodes) -> str:
    """Return the rig or the run that is meant, "" for any: one that goes on has its own name.

    With --at a rig's file is not here.
    """
    word = options.run
    if word is None or (word and (getattr(options, "at", None) is not None or there.running(word))):
        return word or ""
    return str(rigs.data_of(rigs.find(word))["rig"])
