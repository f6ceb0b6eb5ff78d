"""The running nodes of this machine, found by name, by rig or by what they have."""

import argparse
from collections.abc import Sequence

from pcpc.drivers.machine.bystander import keep_off
from pcpc.executive.nodes import live
from pcpc.executive.nodes.live import Live


class Nodes:
    """Those of this machine; the command keeps off the processors of their loops."""

    def running(self, rig: str = "") -> dict[str, Live]:
        """Return the nodes whose loop runs, of all rigs or one, by name."""
        found = live.running(rig)
        keep_off(one.pid for one in found.values())
        return found

    def find(self, node: str = "executive", rig: str = "") -> Live:
        """Return the running node of a name; LiveError."""
        found = live.find(node, rig)
        keep_off([found.pid])
        return found

    def find_for(self, words: Sequence[str]) -> Live:
        """Return the node that has these variables; LiveError."""
        found = live.find_for(words)
        keep_off([found.pid])
        return found

    def chosen(self, options: argparse.Namespace, words: Sequence[str] = ()) -> Live:
        """Return the node that --node names, else the one that has these variables; LiveError."""
        return self.find(options.node) if options.node else self.find_for(words)
