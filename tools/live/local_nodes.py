"""The running nodes of this machine, found by name, by rig or by what they have."""

from collections.abc import Sequence

from pcpc.drivers.errors import Exit
from pcpc.drivers.machine.bystander import keep_off
from pcpc.executive.nodes import live
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.tools.start import rigs


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

    def chosen(self, node: str | None, words: Sequence[str] = ()) -> Live:
        """Return the node of a name, else the one that has these variables; LiveError."""
        return self.find(node) if node else self.find_for(words)

    def leader(self, rig: str, node: str = "executive") -> Live:
        """Return the node that is meant of a rig's run, "" for any; LiveError with what runs."""
        lives = self.running(rig) if rig else {}
        if rig and not lives:
            runs = sorted({str(one.block.description["rig"]) for one in self.running().values()})
            other = f"there are runs of {', '.join(runs)}" if runs else "`pcpc run RIG` starts one"
            raise LiveError(f"{rig}: no run of this rig; {other}", Exit.ENVIRONMENT)
        runs = sorted({one.run for one in lives.values()})
        if len(runs) > 1 and node == "executive":
            raise LiveError(f"{rig}: {len(runs)} runs of this rig; choose {' or '.join(runs)}")
        return self.find(node, rig)

    def rig_of(self, word: str | None) -> str:
        """Return the rig or the run that a word means, "" for any: one that goes on, or a file."""
        if word is None or (word and self.running(word)):
            return word or ""
        return str(rigs.data_of(rigs.find(word))["rig"])
