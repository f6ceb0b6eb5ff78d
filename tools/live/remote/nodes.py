"""The running nodes that a command is about: of this machine, or with --at of another one."""

import argparse
from collections.abc import Sequence
from typing import Protocol

from pcpc.drivers.bystander import keep_off
from pcpc.drivers.errors import Exit
from pcpc.executive.nodes import live
from pcpc.executive.nodes.live import Live, LiveError
from pcpc.tools.start import rigs
from pcpc.tools.terminal.option_notes import refuse


class Nodes(Protocol):
    """Where they are found."""

    def running(self, rig: str = "") -> dict[str, Live]:
        """Return the nodes whose loop runs, of all rigs or one, by name."""
        ...

    def find(self, node: str = "executive", rig: str = "") -> Live:
        """Return the running node of a name; LiveError."""
        ...

    def find_for(self, words: Sequence[str]) -> Live:
        """Return the node that has these variables; LiveError."""
        ...


class _LocalNodes:
    """Those of this machine; the command keeps off the processors of their loops."""

    def running(self, rig: str = "") -> dict[str, Live]:
        found = live.running(rig)
        keep_off(one.pid for one in found.values())
        return found

    def find(self, node: str = "executive", rig: str = "") -> Live:
        return _kept_off(live.find(node, rig))

    def find_for(self, words: Sequence[str]) -> Live:
        return _kept_off(live.find_for(words))


def _kept_off(one: Live) -> Live:
    keep_off([one.pid])
    return one


def nodes_of(options: argparse.Namespace) -> Nodes:
    """Return where the nodes of a command are; UserError."""
    if getattr(options, "at", None) is None:
        refuse(options, "only with --at HOST:PORT", "token_file", "ca", "plain")
        return _LocalNodes()
    from pcpc.tools.live.remote.link import Link
    from pcpc.tools.live.remote.live import RemoteNodes

    if getattr(options, "link", None) is None:
        options.link = Link(options)
    return RemoteNodes(options.link)


def leader(there: Nodes, rig: str, node: str = "executive") -> Live:
    """Return the node that is meant of a rig's run, "" for any rig; LiveError with what runs."""
    found = there.running(rig) if rig else {}
    if rig and not found:
        runs = sorted({str(one.block.description["rig"]) for one in there.running().values()})
        instead = f"runs of {', '.join(runs)} go on" if runs else "`pcpc run RIG` starts one"
        raise LiveError(f"{rig}: no run of this rig; {instead}", Exit.ENVIRONMENT)
    runs = sorted({one.run for one in found.values()})
    if len(runs) > 1 and node == "executive":
        raise LiveError(f"{rig}: {len(runs)} runs of this rig go on; say {' or '.join(runs)}")
    return there.find(node, rig)


def rig_of(options: argparse.Namespace, there: Nodes) -> str:
    """Return the rig or the run that is meant, "" for any: one that goes on has its own name.

    With --at a rig's file is not here.
    """
    word = options.run
    if word is None or (word and (getattr(options, "at", None) is not None or there.running(word))):
        return word or ""
    return str(rigs.data_of(rigs.find(word))["rig"])
