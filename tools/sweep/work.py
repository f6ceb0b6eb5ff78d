"""A shard of a campaign carried out on this machine, from what is there to its table."""

import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcpc.tools.console.progress import Progress
from pcpc.tools.sweep import statements, store
from pcpc.tools.sweep.campaign import Campaign, Shard
from pcpc.tools.sweep.engine import Engine, pieces
from pcpc.tools.sweep.results import failures

LOOK, LATER = 64, 16  # draws between two looks at the statement, or this part of those done


@dataclass
class Work:
    """A shard of a campaign on this machine."""

    campaign: Campaign
    shard: Shard
    folder: Path
    until: str | None
    threads: int | None

    def __post_init__(self) -> None:
        spec = self.campaign.spec()
        self.statement = statements.parsed(self.until) if self.until else None
        if self.until:
            spec["until"] = self.until
        self.store = store.Store(self.folder, spec, self.shard)
        self._counts = {name: [0, 0] for name in self.campaign.controllers}  # failures, runs

    def to_end(self, progress: Progress) -> str:
        """Do what is not done; return what became of the statement, "" without one."""
        campaign, names = self.campaign, self.campaign.controllers
        if self.store.table.exists():
            progress.say(f"{self.store.table}: complete")
            return ""
        progress.show("compiling")
        engine = Engine(Path(campaign.rig), names, campaign.settings, self.threads)
        for name, why in engine.why_alone().items():
            progress.say(f"{name}: runs one by one: {why}")
        if had := len(self.store.rows):
            progress.say(f"{had} rows are there, going on")
        numbered = campaign.numbered(self.shard)
        total = -(-campaign.draws // self.shard.of) * len(names)
        clock = _Clock(progress, total, had)
        done = 0
        while some := self._some(numbered, done):
            left = [one for one in some if not self.store.has(one[0], names)]
            for rows in engine.rows(pieces(left, names, campaign.draw)):
                self.store.add(rows)
                clock.show(len(self.store.rows))
            done += len(some)
            if self.statement and self._decided([number for number, _ in some], self.statement):
                break
        self.store.complete()
        return self._told()

    def _some(self, numbered: Iterator[tuple[int, Any]], done: int) -> list[tuple[int, Any]]:
        """Return the draws until the next look; all of them if nobody looks."""
        if self.statement is None:
            return list(numbered)
        return list(itertools.islice(numbered, max(LOOK, done // LATER)))

    def _told(self) -> str:
        """Return what became of the statement, a line a controller."""
        if self.statement is None:
            return ""
        return "\n".join(f"{name}: {self.statement.told(*n)}" for name, n in self._counts.items())

    def _decided(self, draws: Sequence[int], statement: statements.Statement) -> bool:
        """Count draws where the statement was open; return whether it is for nobody any more."""
        for name, count in self._counts.items():
            if statement.decided(*count) == statements.OPEN:
                rows = [self.store.rows[draw, name] for draw in draws]
                of = statement.requirement
                judged = (row.ok if of is None else row.held.get(of) for row in rows)
                more = failures((row.outcome for row in rows), judged)
                count[:] = count[0] + more[0], count[1] + more[1]
        return all(statement.decided(*n) != statements.OPEN for n in self._counts.values())


class _Clock:
    """Shows how far the rows are, and how long it will take."""

    def __init__(self, progress: Progress, total: int, had: int) -> None:
        self._progress, self._total, self._had = progress, total, had
        self._begin_s = time.monotonic()

    def show(self, count: int) -> None:
        if not self._progress.due():
            return
        rate = (count - self._had) / max(time.monotonic() - self._begin_s, 1e-9)
        left_s = (self._total - count) / max(rate, 1e-9)
        self._progress.show(
            f"{count:,} of {self._total:,} runs, {rate:.1f} runs/s, {_duration(left_s)} left"
        )


def _duration(seconds: float) -> str:
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
