"""`pcpc swarm`: seed after seed a rig and its history, run, and held against every promise.

A seed whose world breaks a promise leaves its folder, made as small as it can be: see `shrink`.
"""

import os
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from typing import Any

import msgspec

from pcpc.drivers.compiled import compile_cache
from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.rig import yamlfile
from pcpc.tools.start import pool, rigs
from pcpc.tools.study.swarm.case import Case
from pcpc.tools.study.swarm.commands import SwarmRequest
from pcpc.tools.study.swarm.draws import world_of
from pcpc.tools.study.swarm.features import ODD, possible_pairs
from pcpc.tools.study.swarm.files import HISTORY, World, write, write_laws
from pcpc.tools.study.swarm.promises import PROMISES, broken
from pcpc.tools.study.swarm.shrink import smallest
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.progress import Progress
from pcpc.tools.terminal.rooms import part_of

_SEEDS, _LOOK_S, _AHEAD = 100, 0.5, 2  # without a limit; between looks; seeds a process waits with
_SHOWN = 3  # lines of a broken promise


class Row(msgspec.Struct):
    """What came of a seed."""

    seed: int
    cycles: int  # of all nodes, by all ways
    simulated_s: float  # what the rig did in them
    features: list[str]
    found: dict[str, list[str]]  # by promise
    refused: str  # in a line; "" for a rig that ran
    spent_s: float  # of a processor
    folder: str = ""  # of what was found


class Told(msgspec.Struct):
    """What a swarm came to."""

    seeds: int
    first: int
    cycles: int
    cycles_per_s: float  # of a processor
    times_real_time: float  # of the rig, by all ways, a processor
    seeds_per_s: float
    promises: int  # checked, in all seeds
    refused: int
    pairs: dict[str, int]  # of features, met so often
    never: list[str]  # pairs that a drawn rig may have, and none had
    broken: list[Row]


def command(request: SwarmRequest) -> int:
    """Run seeds, or a folder again; NOT_MET if a promise is broken, or none was checked."""
    if request.replay is not None:
        return _replayed(request, Path(request.replay))
    names = request.around.split(",") if request.around else []
    bases: list[str | None] = [str(Path(rigs.find(name)).resolve()) for name in names] or [None]
    progress, rows = Progress(request.quiet), list[Row]()
    begin_s, code = time.monotonic(), Exit.OK
    try:
        for row in _rows(request, bases, begin_s):
            rows.append(row)
            for name, lines in row.found.items():
                progress.say(f"seed {row.seed}: {name}: {lines[0]}; {row.folder}")
            cycles, wrong = sum(one.cycles for one in rows), sum(bool(one.found) for one in rows)
            progress.show(f"{len(rows)} seeds, {cycles:,} cycles, {wrong} with a broken promise")
    except KeyboardInterrupt:
        code = Exit.INTERRUPTED
    progress.close()
    possible = possible_pairs() if bases == [None] else set()
    told = _told(request.seed, rows, time.monotonic() - begin_s, possible)
    print(screen.json_text(msgspec.to_builtins(told)) if request.json else "\n".join(_lines(told)))
    nothing = code == Exit.OK and not told.promises
    return Exit.NOT_MET if told.broken or nothing else code


def _rows(request: SwarmRequest, bases: Sequence[str | None], begin_s: float) -> Iterator[Row]:
    """Yield what comes of seed after seed, until the limits that are asked for are reached."""
    unlimited = (request.for_s, request.cycles, request.seeds) == (None, None, None)
    seeds = _SEEDS if unlimited else request.seeds
    cycles = done = 0
    output = str(Path(request.output).resolve()) if request.dask else request.output
    with _workers(request) as (workers, count):
        pending: set[Any] = set()
        while True:
            late = request.for_s is not None and time.monotonic() - begin_s >= request.for_s
            enough = late or (request.cycles is not None and cycles >= request.cycles)
            while not enough and len(pending) < _AHEAD * count:
                if seeds is not None and done >= seeds:
                    break
                seed, base = request.seed + done, bases[done % len(bases)]
                pending.add(workers.submit(row_of, seed, base, output))
                done += 1
            if not pending:
                return
            over, pending = wait(pending, _LOOK_S, FIRST_COMPLETED)
            for one in over:
                cycles += one.result().cycles
                yield one.result()


@contextmanager
def _workers(request: SwarmRequest) -> Iterator[tuple[Any, int]]:
    """Give who does the seeds, and how many at once."""
    if request.dask is not None:
        cluster = part_of("study/sweep", "cluster")
        with cluster.executor("--dask", request.dask) as both:
            yield both
        return
    with pool.workers(request.jobs) as workers:
        yield workers, request.jobs or os.cpu_count() or 1


def row_of(seed: int, base: str | None, output: str) -> Row:
    """Return what comes of a seed; what it breaks is made small, and stays in a folder."""
    begin_s, world = _spent_s(), world_of(seed, base)
    row = checked(world)
    row.spent_s = _spent_s() - begin_s
    if row.found:
        folder = Path(output) / f"seed-{seed}"
        write(smallest(world, lambda one: same(row, checked(one, row.found))), folder)
        row.folder = str(folder)
    return row


def _spent_s() -> float:
    """Return what this process and those it has waited for have spent of processors."""
    return sum(os.times()[:4])


def same(one: Row, other: Row) -> bool:
    """Return whether the first promise that one breaks is broken by the other."""
    return next(iter(one.found)) in other.found


def checked(world: World, names: Sequence[str] | dict[str, Any] = PROMISES) -> Row:
    """Run a world in a folder of its own; return what came."""
    laws = compile_cache.folders()[0] / "swarm"
    laws.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="pcpc-swarm-") as folder:
        write(world, Path(folder), laws)
        return _checked(world, Path(folder), names, laws)


def _checked(world: World, folder: Path, names: Any, laws: Path | None = None) -> Row:
    case = Case(world, folder, laws)
    row = Row(world["seed"], 0, 0.0, world["features"], {}, "", 0.0)
    try:
        row.found = broken(case, names)
        if world["wrong"]:
            row.found = {"refusal": [f"not refused: {world['wrong']}"]}
    except UserError as error:
        row.refused = str(error)
        allowed = world["wrong"] or ODD in world["features"]
        if not allowed or "\n" in row.refused:
            row.found = {"refusal": [row.refused]}
    except Exception as error:
        row.found = {"refusal": [f"{type(error).__name__}: {error}"]}
    row.cycles = case.cycles
    row.simulated_s = row.cycles / (1 + len(world["plants"] or "1")) / world["rate_hz"]
    return row


def _replayed(request: SwarmRequest, folder: Path) -> int:
    """Run what lies in a folder again."""
    world = dict(yamlfile.load(folder / HISTORY).data)
    with tempfile.TemporaryDirectory(prefix="pcpc-swarm-") as name:
        shutil.copytree(folder, name, dirs_exist_ok=True)
        write_laws(world, Path(name))
        row = _checked(world, Path(name), PROMISES)
    if request.json:
        print(screen.json_text(msgspec.to_builtins(row)))
    else:
        said = [f"{name}: {line}" for name, lines in row.found.items() for line in lines[:_SHOWN]]
        held = f"refused: {row.refused}" if row.refused else "every promise held"
        print("\n".join(said or [f"{held}, {row.cycles:,} cycles"]))
    kept = not (row.found or (row.refused and not world["wrong"]))
    return Exit.OK if kept else Exit.NOT_MET


def _told(
    first: int, rows: Sequence[Row], spent_s: float, possible: Iterable[tuple[str, str]]
) -> Told:
    pairs = Counter(
        " + ".join(two) for row in rows for two in combinations(sorted({*row.features}), 2)
    )
    never = sorted({" + ".join(two) for two in possible} - {*pairs})
    cycles, ran = sum(row.cycles for row in rows), [row for row in rows if not row.refused]
    busy_s = max(sum(row.spent_s for row in rows), 1e-9)
    return Told(
        len(rows), first, cycles, cycles / busy_s,
        sum(row.simulated_s for row in rows) / busy_s, len(rows) / spent_s,
        len(ran) * len(PROMISES),
        len(rows) - len(ran), dict(sorted(pairs.items())), never,
        [row for row in rows if row.found],
    )  # fmt: skip


def _lines(told: Told) -> list[str]:
    """Return a summary in numbers."""
    met = len(told.pairs)
    rare = sorted(told.pairs, key=lambda two: told.pairs[two])[:_SHOWN]
    return [
        f"{told.seeds:,} seeds from {told.first} on, {told.refused:,} of them refused",
        f"{told.cycles:,} cycles, {told.cycles_per_s:,.0f} a second of a processor, "
        f"{told.times_real_time:.1f} x real time",
        f"{told.promises:,} promises checked, {len(told.broken)} seeds broke one",
        f"{met:,} pairs of features met, the rarest: {', '.join(rare) or 'none'}",
        *[f"{len(told.never):,} pairs never: {', '.join(told.never[:_SHOWN])}"] * bool(told.never),
        *(f"seed {row.seed}: {name}: {lines[0]}\n  pcpc swarm --replay {row.folder}"
          for row in told.broken for name, lines in row.found.items()),
    ]  # fmt: skip
