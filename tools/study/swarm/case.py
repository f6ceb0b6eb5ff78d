"""A world in its folder: its rig, and the log of its run."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.drivers.can.wire import deliver
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.after.verdict.summary import Summary, summarise
from pcpc.tools.after.verdict.virtual_end import to_end
from pcpc.tools.study.swarm.files import RIG, World
from pcpc.tools.terminal.progress import Progress

QUIET = Progress(quiet=True)


class Others(Progress):
    """What a user and another sender do to a run, once it has come to a cycle."""

    def __init__(self, run: VirtualRun, acts: list[World]) -> None:
        super().__init__(quiet=True)
        self._run, self._left = run, acts
        self.done: list[tuple[str, int, World]] = []  # to which node, behind which pass

    def show(self, line: str) -> None:
        """Do the next one, if it is time: a run comes here behind each of its pieces."""
        blocks = self._run.blocks
        if not self._left or blocks[0].loop.passes < self._left[0]["cycle"]:
            return
        act = self._left.pop(0)
        place = int(act.get("node", "executive") != "executive")
        block, made = blocks[place], self._run.plans[place]
        self.done.append((block.description["node"], int(block.loop.passes), act))
        if "set" in act:
            index = made.table.index
            block["mail_index"][: len(act["set"])] = [index[name] for name in act["set"]]
            block["mail_value"][: len(act["set"])] = [*act["set"].values()]
            block.mail.count = len(act["set"])
            block.mail.request += 1
        elif "send" in act:
            wire = block.loop.wire
            for count in range(act["send"]):
                frame: Any = np.full(wire.inbox.shape[1], count, np.uint8)
                word = int(made.tx_frames[-1].word)
                frame[:8] = [*word.to_bytes(4, "little"), 8, 0, 0, 0]
                deliver(frame, wire)
        else:
            self._run.stop()


@dataclass
class Case:
    """A world that is run in its folder."""

    world: World
    folder: Path
    laws: Path | None = None  # see `files.write`
    cycles: int = 0  # done for it, by all ways
    acts: list[tuple[str, int, World]] = field(default_factory=list)  # done by Others

    @cached_property
    def rig(self) -> Rig:
        """The rig; RigError, BusError."""
        return load_rig(self.folder / RIG)

    @cached_property
    def path(self) -> Path:
        """The log of its run."""
        return self.recorded(self.folder / "log.mcap")

    @cached_property
    def outcome(self) -> Outcome:
        """What became of its nodes."""
        self.path  # noqa: B018
        return self._outcome

    @cached_property
    def opened(self) -> Opened:
        """Its run."""
        return Opened(self.path)

    @property
    def log(self) -> logs.Log:
        """The records of its run."""
        return self.opened.log

    @cached_property
    def summary(self) -> Summary:
        """What its run came to."""
        return summarise(self.rig, self.log, self.outcome, Judge.of(self.rig))

    @property
    def length(self) -> int:
        """How many cycles the executive did."""
        return len(self.log.node["executive"].cycle)

    def at(self, what: str, least: int, past: int) -> int:
        """Return the drawn cycle for a promise."""
        return least + int(self.world["at"][what] * max(past - least, 1))

    def turn(self, of: int) -> int:
        """Return whose turn it is of so many, by the seed: slow ways take turns."""
        return int(self.world["at"]["sample"] * 2**20) % of

    def recorded(self, path: Path) -> Path:
        """Run it into a log."""
        self._outcome = Outcome("virtual", "memory", changed=[])
        run = VirtualRun(self.rig, path)
        others = Others(run, [*self.world.get("acts", ())])
        to_end(run, self._outcome, others)
        self.acts = others.done
        self.count(run)
        return path

    def count(self, run: VirtualRun) -> None:
        """Count the cycles of the nodes."""
        self.cycles += sum(int(block.loop.passes) for block in run.blocks)
