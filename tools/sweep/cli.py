"""`pcpc sweep`: thousands of runs of a rig in virtual time, a table, a report, a statement."""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.console.progress import Progress
from pcpc.tools.log.outfile import new_file
from pcpc.tools.rigs import find
from pcpc.tools.sweep import rerun, statements, store, told
from pcpc.tools.sweep.campaign import Campaign, Shard
from pcpc.tools.sweep.engine import FAULT, REFUSED, Engine, Row, pieces
from pcpc.tools.sweep.vary import all_parsed, grid_size

DRAWS = 1000
MOST = 10_000_000  # draws of a campaign that ends by its statement
LOOK = 64  # draws between two looks at the statement


def command(options: argparse.Namespace) -> int:
    """Carry out `pcpc sweep`; return the exit code."""
    if options.words[0] == "merge":
        return _merge(options)
    if options.words[0] == "rerun":
        return rerun.command(options)
    if options.words[1:]:
        raise RigError(f"{' '.join(options.words[1:])}: one rig at a time")
    if options.threads is not None and options.threads < 1:
        raise RigError(f"--threads {options.threads}: expected 1 or more")
    options.rig = find(options.words[0])
    campaign = _campaign(options)
    campaign.check()
    shard = Shard.parsed(options.shard) if options.shard else Shard()
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    name = campaign.of[0].config.rig
    folder = Path(options.output or f"runs/{stamp}-sweep-{name}")
    statement = statements.parsed(options.until) if options.until else None
    if statement and shard.of > 1:
        raise RigError("--until needs all draws in their order; leave --shard out")
    progress = Progress(options.quiet)
    work = Work(campaign, shard, folder, statement, options.threads)
    try:
        ended = work.to_end(progress)
    except KeyboardInterrupt:
        progress.close()
        print(f"{len(work.store.rows)} rows are in {folder}; to go on, the same command with "
              f"-o {folder}")  # fmt: skip
        return Exit.INTERRUPTED
    finally:
        work.store.close()
    progress.close()
    if shard.of > 1:
        print(f"{work.store.table}: {len(work.store.rows)} rows; when all shards are done: "
              f"pcpc sweep merge {folder}")  # fmt: skip
        return Exit.OK
    return _tell(folder, [folder], ended)


def _campaign(options: argparse.Namespace) -> Campaign:
    controllers = (
        tuple(dict.fromkeys(options.controllers.split(","))) if options.controllers else ()
    )
    settings = tuple(options.set)
    first = Campaign(options.rig, controllers or ("",), tuple(options.vary), 1, settings=settings)
    if not controllers:
        controllers = (load_rig(options.rig, None, settings).config.controller,)
    draws = options.draws
    if options.sampling == "grid" and draws is None:
        draws = grid_size(all_parsed(first.vary))
    if draws is None:
        draws = MOST if options.until else DRAWS
    if options.until and options.sampling in ("lhs", "grid"):
        raise RigError(f"--until needs draws that can go on; --sampling {options.sampling} cannot")
    if draws < 1:
        raise RigError(f"--draws {draws}: expected 1 or more")
    sampling = options.sampling or ("random" if options.until or not options.vary else "sobol")
    return Campaign(
        str(options.rig), controllers, tuple(options.vary), draws, sampling, options.seed, settings
    )


@dataclass
class Work:
    """A shard of a campaign on this machine."""

    campaign: Campaign
    shard: Shard
    folder: Path
    statement: statements.Statement | None
    threads: int | None

    def __post_init__(self) -> None:
        spec = self.campaign.spec()
        if self.statement is not None:
            spec["until"] = str(self.statement)
        self.store = store.Store(self.folder, spec, self.shard)

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
        told = ""
        while some := self._some(numbered):
            left = [one for one in some if not self.store.has(one[0], names)]
            for rows in engine.rows(pieces(left, names, campaign.draw)):
                self.store.add(rows)
                clock.show(len(self.store.rows))
            if self.statement is not None:
                told = self._look(some[-1][0] + 1)
                if told:
                    break
        self.store.complete()
        return told

    def _some(self, numbered: Iterator[tuple[int, Any]]) -> list[tuple[int, Any]]:
        """Return the draws until the next look; all of them if nobody looks."""
        if self.statement is None:
            return list(numbered)
        return [one for one, _ in zip(numbered, range(LOOK), strict=False)]

    def _look(self, draws: int) -> str:
        """Return the statement's outcome for every controller, "" while one is open."""
        assert self.statement is not None, "it is asked for"
        lines = []
        for name in self.campaign.controllers:
            rows = [self.store.rows[i, name] for i in range(draws)]
            failures, runs = counted(rows, self.statement.requirement)
            if not self.statement.decided(failures, runs):
                return ""
            lines.append(f"{name}: {self.statement.told(failures, runs)}")
        return "\n".join(lines)


def counted(rows: Sequence[Row], requirement: str | None) -> tuple[int, int]:
    """Return failures and runs, of a requirement or of the verdict; refused runs count as none."""
    ran = [row for row in rows if row.outcome != REFUSED]
    if requirement is None:
        return sum(not row.ok for row in ran), len(ran)
    failed = [row.outcome == FAULT or row.held.get(requirement) is False for row in ran]
    return sum(failed), len(ran)


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


def _merge(options: argparse.Namespace) -> int:
    folders = [Path(name) for name in options.words[1:]]
    if not folders:
        raise RigError("pcpc sweep merge: name the folders of the shards")
    return _tell(Path(options.output or folders[0]), folders, "")


def _tell(folder: Path, folders: Sequence[Path], ended: str) -> int:
    """Write the whole table, tell what it says."""
    import pyarrow.parquet

    table, spec = store.merged(folders)
    if len(folders) > 1 or len(list(store.tables(folder))) != 1:
        folder.mkdir(parents=True, exist_ok=True)
        with new_file(folder / "sweep.parquet", force=True) as unfinished:
            pyarrow.parquet.write_table(table, unfinished)
    print(told.summary(table, spec, folder))
    for line in ended.splitlines():
        print(line)
    print(folder)
    return Exit.OK
