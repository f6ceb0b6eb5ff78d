"""A shard of a campaign carried out on this machine, from what is there to its table."""

import itertools
import time
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcpc.executive.errors import RigError
from pcpc.tools.study.engine import REFUSED, Engine, pieces
from pcpc.tools.study.sweep import decision, statements, store
from pcpc.tools.study.sweep.campaign import Campaign, Shard
from pcpc.tools.study.sweep.cluster import Cluster
from pcpc.tools.study.sweep.numbers import MOST_THREADS, check_whole
from pcpc.tools.study.sweep.results import Counts, Results, counts
from pcpc.tools.study.sweep.search import Rows, Search
from pcpc.tools.terminal.progress import Progress


@dataclass
class Work:
    """A shard of a campaign on this machine."""

    campaign: Campaign
    shard: Shard
    folder: Path
    until: str | None
    threads: int | None
    scheduler: str | None = None
    search: Search | None = None

    def __post_init__(self) -> None:
        """Claim the folder. RigError for what contradicts itself, or is another campaign's."""
        spec = self.campaign.spec()
        if self.threads is not None:
            check_whole("threads", self.threads, 1, MOST_THREADS)
        if self.scheduler is not None and not self.scheduler.strip():
            raise RigError(f"--scheduler {self.scheduler!r}: expected tcp://HOST:PORT or local[:N]")
        if self.threads is not None and self.scheduler:
            raise RigError("--threads is of this process; workers of --scheduler have their own")
        self.statement = None if self.until is None else statements.parse(self.until)
        if self.statement is not None:
            if self.shard.of > 1:
                raise RigError("--until needs all draws in their order; leave --shard out")
            if self.statement.requirement is not None:
                self.campaign.check_requirement(self.statement.requirement)
            spec["until"] = self.until
        if self.search is not None:
            spec |= self.search.spec()
        self.store = store.Store(self.folder, spec, self.shard)
        self._counts = dict.fromkeys(self.campaign.controllers, Counts())

    def to_end(self, progress: Progress) -> str:
        """Do what is not done; return what became of the statement or the search, "" of neither.

        NothingToTellError: the rows tell nothing; if none was there before, none is kept.
        """
        try:
            return self._result(progress)
        except statements.NothingToTellError:
            self.store.take_back()
            raise

    def _result(self, progress: Progress) -> str:
        if self.store.outcome is None:
            self._complete(progress)
        else:
            progress.say(f"{self.store.path}: complete")
        if self.shard.of > 1:
            return ""
        table = self.store.table()
        store.export(table, self.folder)
        if self.until is None:
            return str(self.store.outcome)
        found = decision.decisions(Results(table, self.store.spec), self.until)
        return "\n".join(one.text for one in found)

    def check_runs(self) -> None:
        """Raise NothingToTellError where all runs of the campaign are refused; none is kept."""
        rows = self.store.values() if self.shard.of == 1 else ()
        first = next(iter(rows), None)
        if first is not None and all(row.outcome == REFUSED for row in rows):
            self.store.take_back()
            what = f"{self.folder}: all runs were refused: {first.why}"
            raise statements.NothingToTellError(what)

    def _complete(self, progress: Progress) -> None:
        """Do what is not done."""
        progress.show("compiling")
        campaign = self.campaign
        path = Path(campaign.rig).resolve()
        engine = Engine(path, campaign.controllers, campaign.settings, self.threads)
        for name, why in engine.why_alone().items():
            progress.say(f"{name}: runs one by one: {why}")
        if had := len(self.store):
            progress.say(f"{had} rows are there, going on")
        with self._runner(engine) as runner:
            outcome_text = self._run(runner.rows, progress)
        if changed := campaign.changed(self.store.spec):
            what = f"{changed} changed while the campaign ran; rows may be of either"
            raise RigError(f"{campaign.rig}: {what}: begin again with another -o")
        if outcome_text:
            (self.folder / "outcome.txt").write_text(outcome_text, encoding="utf-8")
        self.store.complete(outcome_text)

    def _runner(self, engine: Engine) -> AbstractContextManager[Engine | Cluster]:
        if self.scheduler is None:
            return nullcontext(engine)
        return Cluster(self.scheduler, self.campaign, self.store)

    def _run(self, rows_of: Rows, progress: Progress) -> str:
        """Do the draws that are not there; return what came out."""
        campaign, names, rows = self.campaign, self.campaign.controllers, self.store
        total = -(-campaign.draws // self.shard.of) * len(names)
        clock = _Clock(progress, None if campaign.sampling == "rare" else total, len(rows))
        if self.search is not None:
            return self.search.outcome(rows_of, self.store, lambda: clock.show(len(rows)))

        def do(numbered: Iterable[tuple[int, Any]]) -> None:
            left = (one for one in numbered if not self._is_done(*one))
            for found in rows_of(pieces(left, names, campaign.draw)):
                self.store.add(found)
                clock.show(len(rows))

        numbered = campaign.numbered(self.shard)
        if self.statement is None:
            do(numbered)
            return ""
        for size in decision.blocks():
            some = list(itertools.islice(numbered, size))
            do(some)
            if not some or self._is_decided([number for number, _ in some], self.statement):
                break
        return ""

    def _is_done(self, number: int, point: Any) -> bool:
        """Return whether a draw's rows are there; RigError where they are of other values."""
        names, rows = self.campaign.controllers, self.store
        there = [rows[number, name] for name in names if (number, name) in rows]
        for row in there:
            draw = self.campaign.draw(row.controller, number, point)
            if (row.seed, row.values) != (draw.seed, draw.values):
                what = f"draw {number} of {row.controller} has other values in its row"
                raise RigError(f"{self.store.path}: {what}; begin again with another -o")
        return len(there) == len(names)

    def _is_decided(self, draws: Sequence[int], statement: statements.Statement) -> bool:
        """Count draws where the statement was open; return whether it is for nobody any more."""
        for name, count in self._counts.items():
            if statement.outcome(*count) == statements.OPEN:
                rows = [self.store[draw, name] for draw in draws]
                of = statement.requirement
                judged = (row.ok if of is None else row.held.get(of) for row in rows)
                self._counts[name] = count.plus(counts((row.outcome for row in rows), judged))
                if self._counts[name].runs == 0:
                    why = f"with draw {draws[0]} {rows[0].why or 'nothing was judged'}"
                    what = f"no run of {name} could be judged, {why}"
                    what = f"--until {self.until!r}: {what}; give the rig `require`"
                    raise statements.NothingToTellError(what)
        return all(statement.outcome(*n) != statements.OPEN for n in self._counts.values())


class _Clock:
    """Shows how far the rows are, and how long it will take."""

    def __init__(self, progress: Progress, total: int | None, had: int) -> None:
        """`total`: None where nobody knows."""
        self._progress, self._total, self._had = progress, total, had
        self._begin_s = time.monotonic()

    def show(self, count: int) -> None:
        if not self._progress.due():
            return
        rate = (count - self._had) / max(time.monotonic() - self._begin_s, 1e-9)
        if self._total is None:
            self._progress.show(f"{count:,} runs, {rate:.1f} runs/s")
            return
        left_s = (self._total - count) / max(rate, 1e-9)
        self._progress.show(
            f"{count:,} of {self._total:,} runs, {rate:.1f} runs/s, {_duration(left_s)} left"
        )


def _duration(seconds: float) -> str:
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
