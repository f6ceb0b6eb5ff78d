"""Draws to rows: a campaign's runs on all processors, judged one by one, in any order.

A row is what a run came to; it depends on its draw and controller alone, not on who did it, when,
or beside which others. Threads do the runs (compiled code holds no lock of Python's); a piece is
WIDTH draws of one controller.
"""

import itertools
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pcpc.drivers.compiled.lanes import WIDTH
from pcpc.executive.batch.group import Traces
from pcpc.executive.batch.runs import BatchRuns, Case, RunResult
from pcpc.executive.errors import RigError
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict.findings import JUDGED
from pcpc.tools.after.verdict.imagined_logs import imagined_log
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.after.verdict.outcome import changed_settings
from pcpc.tools.after.verdict.requirements import Bound
from pcpc.tools.after.verdict.timing import TIMING_COLUMNS

AHEAD = 2  # pieces in flight for each thread
SPARE = 2  # threads beyond the number of processors


@dataclass(frozen=True)
class Draw:
    """One point of a campaign: its number, noise seed and values by name."""

    number: int
    seed: int
    values: Mapping[str, float]


@dataclass(frozen=True)
class RunVerdict:
    """What a run came to. `ok`: None where nothing, or not all, could be judged, and `why`.

    `unjudged`: why limits and requirements were not. `alone`: why it was not done in lanes; "" if
    it was.
    """

    draw: int
    controller: str
    seed: int
    values: Mapping[str, float]
    outcome: str
    ok: bool | None
    why: str = ""
    metrics: Mapping[str, float] = field(default_factory=dict)
    margins: Mapping[str, float | None] = field(default_factory=dict)
    held: Mapping[str, bool | None] = field(default_factory=dict)
    alone: str = ""
    unjudged: Mapping[str, str] = field(default_factory=dict)


RAN, FAULT, REFUSED = "ran", "fault", "refused"  # outcomes
NOTHING = "nothing was judged"  # of a rig that states no limit and no requirement
Piece = tuple[str, list[Draw]]  # at most WIDTH draws of a controller
Pieces = Iterable[Piece]


class Bench:
    """Runs of one rig and controller with their judge, for one thread."""

    def __init__(
        self,
        path: Path,
        controller: str,
        settings: Sequence[str],
        traces: Traces | None = None,
        names: Sequence[str] = (),
    ) -> None:
        """Raise RigError, BusError, EvaluationError for what is wrong with the rig.

        `traces`: memory that the benches of a thread share; `names`: what is kept beside what the
        judge needs.
        """
        self.controller, self.settings = controller, list(settings)
        rig = load_rig(path, controller, settings)
        self.judge = Judge.of(rig)
        log = imagined_log(rig, "lockstep")
        self.judge.check_requirements(log)
        found = self.judge.needed_columns(log, drawn=False, names=names)
        asked = {role: found[role][: -len(TIMING_COLUMNS)] for role in rig.roles}
        wanted = {role: list(dict.fromkeys(columns)) for role, columns in asked.items()}
        self.runs = BatchRuns(path, controller, settings, wanted, traces)
        self._those: Bound | None = None  # of all logs of the lanes

    def rows(self, draws: Sequence[Draw]) -> list[RunVerdict]:
        """Return the rows of at most WIDTH draws."""
        done = self.runs.done([Case(draw.seed, draw.values) for draw in draws])
        return [self._row(draw, one) for draw, one in zip(draws, done, strict=True)]

    def _row(self, draw: Draw, done: RunResult) -> RunVerdict:
        about = draw.number, self.controller, draw.seed, dict(draw.values)
        if done.log is None:
            return RunVerdict(*about, REFUSED, False, done.refused, alone=done.alone)
        try:
            words = [*self.settings, *(f"{name}={value}" for name, value in draw.values.items())]
            if self._those is None and not done.alone:
                self._those = self.judge.check_requirements(done.log)
            those = None if done.alone else self._those
            found = self.judge.judge(done.log, changed_settings(words), done.fault, those)
        except RigError as error:
            return RunVerdict(
                *about, FAULT if done.fault else RAN, False, str(error), alone=done.alone
            )
        unmet = [str(one) for one in found.findings if one.held is False]
        failed = [done.fault, *unmet] if done.fault else unmet
        unjudged = [one for one in found.findings if one.held is None]
        left = [f"{one.key} was not judged: {one.why}" for one in unjudged]
        left += [NOTHING] * all(one.kind not in JUDGED for one in found.findings)
        ok = False if failed else None if left else True
        return RunVerdict(
            *about,
            FAULT if done.fault else RAN,
            ok,
            next(iter([*failed, *left]), ""),
            found.metrics,
            {one.name: one.margin for one in found.requirements},
            {one.name: one.held for one in found.requirements},
            done.alone,
            {one.key: one.why for one in unjudged},
        )


class Engine:
    """The runs of a campaign on `threads` threads of this process."""

    def __init__(
        self,
        path: Path,
        controllers: Sequence[str],
        settings: Sequence[str] = (),
        threads: int | None = None,
    ) -> None:
        """Raise RigError, BusError for what is wrong with the rig; it is compiled here, once.

        `threads`: by default two more than there are processors, since a run is an eighth Python:
        while one thread waits for its lock, another one computes.
        """
        self._about = path, list(settings)
        self.threads = threads or len(os.sched_getaffinity(0)) + SPARE
        self._own = threading.local()
        self.first = {name: Bench(path, name, settings) for name in controllers}
        self._turn = threading.Lock()

    def why_alone(self) -> dict[str, str]:
        """Return why runs of a controller are done one by one, of those that are."""
        return {name: bench.runs.why for name, bench in self.first.items() if bench.runs.why}

    def rows(self, draws: Pieces) -> Iterator[list[RunVerdict]]:
        """Yield the rows of pieces as they are done: of at most WIDTH draws of a controller.

        Whoever stops to listen ends the work, after what is being done.
        """
        with ThreadPoolExecutor(self.threads) as pool:
            flying: set[Future[list[RunVerdict]]] = set()
            try:
                for piece in draws:
                    flying.add(pool.submit(self.piece, *piece))
                    while len(flying) >= AHEAD * self.threads:
                        done, flying = wait(flying, return_when=FIRST_COMPLETED)
                        yield from (one.result() for one in done)
                while flying:
                    done, flying = wait(flying, return_when=FIRST_COMPLETED)
                    yield from (one.result() for one in done)
            finally:
                for one in flying:
                    one.cancel()

    def piece(self, controller: str, draws: Sequence[Draw]) -> list[RunVerdict]:
        """Return the rows of at most WIDTH draws, done in the thread that calls."""
        return self._bench(controller).rows(draws)

    def _bench(self, controller: str) -> Bench:
        """Return this thread's own; one at a time is made, as code is compiled on the way."""
        if not hasattr(self._own, "benches"):
            self._own.benches, self._own.traces = {}, {}
        own: dict[str, Bench] = self._own.benches
        if controller not in own:
            path, settings = self._about
            with self._turn:
                own[controller] = Bench(path, controller, settings, self._own.traces)
        return own[controller]


def pieces(
    numbered: Iterable[tuple[int, Any]],
    controllers: Sequence[str],
    draw: Callable[[str, int, Any], Draw],
) -> Iterator[Piece]:
    """Yield numbered points in pieces of WIDTH, each for every controller, as draws."""
    left = iter(numbered)
    while some := list(itertools.islice(left, WIDTH)):
        for name in controllers:
            yield name, [draw(name, number, point) for number, point in some]
