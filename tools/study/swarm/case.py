"""A world in its folder: its rig, and the log of its run."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

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


class Asking(Progress):
    """Asks a run to end once it has come to a cycle, as its user may; None: never."""

    def __init__(self, run: VirtualRun, cycle: int | None) -> None:
        super().__init__(quiet=True)
        self._run, self._cycle = run, cycle

    def show(self, line: str) -> None:
        """Look how far the run is, which is told behind each of its pieces."""
        if self._cycle is not None and self._run.blocks[0].loop.passes >= self._cycle:
            self._run.stop()


@dataclass
class Case:
    """A world that is run in its folder."""

    world: World
    folder: Path
    laws: Path | None = None  # see `files.write`
    cycles: int = 0  # done for it, by all ways

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
        to_end(run, self._outcome, Asking(run, self.world.get("asked")))
        self.count(run)
        return path

    def count(self, run: VirtualRun) -> None:
        """Count the cycles of the nodes."""
        self.cycles += sum(int(block.loop.passes) for block in run.blocks)
