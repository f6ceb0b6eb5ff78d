"""The runs of studies: in lanes where enough are alike, else one by one, with the same bits.

Alike are cases of one rig and controller that differ in seed, numbers of settings and traces alone.
What lanes cannot do, or refuse, `alone` does anew from the rig's file.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pcpc import plants
from pcpc.executive.errors import RigError
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.plants.judging import Run
from pcpc.plants.study import Case, CaseResult
from pcpc.tools.start.native import native
from pcpc.tools.start.pool import each
from pcpc.tools.terminal.progress import Progress

if TYPE_CHECKING:
    from pcpc.executive.log.reader import Log
    from pcpc.tools.after.verdict.judge import Judge
    from pcpc.tools.study.engine import Bench

TRACE_POINTS = 1500  # of a figure's line: more than its pixels
LEAST = 3  # alike runs: lanes cost as much as two alone, however few there are
MANY = 400  # runs for lanes that win back their compilation, once for this machine's processor
PLANTS = Path(plants.__file__).resolve().parent


@dataclass(frozen=True)
class Common:
    """What alike cases have in common; `settings`: those that are no numbers of blocks.

    `traces`: what any of them keeps.
    """

    rig: str
    controller: str
    settings: tuple[str, ...]
    traces: tuple[str, ...] = ()


@dataclass(frozen=True)
class OwnCase:
    """A case, and what it has of its own: a seed, or the rig's (None), and numbers of settings."""

    case: Case
    seed: int | None
    numbers: dict[str, float]


@dataclass(frozen=True)
class Piece:
    """Cases that are done together, with their places among all."""

    common: Common
    own: tuple[OwnCase, ...]
    places: tuple[int, ...]


def case_results(cases: Sequence[Case], progress: Progress, jobs: int | None) -> list[CaseResult]:
    """Return the results of cases, in their order, done on `jobs` processes."""
    todo = pieces(cases)
    found: dict[int, CaseResult] = {}
    with native(len(todo) < len(cases)):
        for piece, made in zip(todo, each(results, todo, progress, jobs, _size), strict=True):
            found |= zip(piece.places, made, strict=True)
    return [found[place] for place in range(len(cases))]


def _size(piece: Piece) -> int:
    return len(piece.own)


def pieces(cases: Sequence[Case], least: int = MANY) -> list[Piece]:
    """Return the cases in pieces for lanes, or of one; alike ones one after the other.

    All are of one where fewer than `least` are for lanes.
    """
    alike: dict[Common, list[tuple[OwnCase, int]]] = {}
    for place, case in enumerate(cases):
        common, own = _common_and_own(case)
        alike.setdefault(common, []).append((own, place))
    many = sum(len(some) for some in alike.values() if len(some) >= LEAST) >= least
    return [
        Piece(_keeping(common, one_kind), *zip(*some, strict=True))
        for common, one_kind in alike.items()
        for some in _batches(one_kind, many)
    ]


def _keeping(common: Common, cases: list[tuple[OwnCase, int]]) -> Common:
    names = dict.fromkeys(name for own, _ in cases for name in own.case.traces)
    return replace(common, traces=tuple(names))


def _batches(cases: list[tuple[OwnCase, int]], many: bool) -> Iterator[list[tuple[OwnCase, int]]]:
    from pcpc.drivers.compiled.lanes import WIDTH  # numba

    width = WIDTH if many and len(cases) >= LEAST else 1
    for first in range(0, len(cases), width):
        yield cases[first : first + width]


def _common_and_own(case: Case) -> tuple[Common, OwnCase]:
    """Return what of a case others may have as well, and the rest."""
    blocks, rigs = _names_and_numbers(case.rig)
    seed, numbers = None, {}
    common: list[str] = []
    for setting in case.settings:
        name, _, text = setting.partition("=")
        value = _value(text)
        if blocks and name == "seed" and type(value) is int:
            seed = value
        elif name.partition(".")[0] in blocks and _may_differ(name, value):
            numbers[name] = float(value)
        elif type(value) not in (int, float) or rigs.get(name) != value or _is_given(name, common):
            common.append(setting)
    return Common(case.rig, case.controller, tuple(common)), OwnCase(case, seed, numbers)


def _is_given(name: str, settings: Sequence[str]) -> bool:
    return any(setting.partition("=")[0] == name for setting in settings)


def _may_differ(name: str, value: Any) -> bool:
    """Return whether alike runs may differ in a number: not in counts, but in seeds.

    A step decides by counts. One that decides by a float parts the lanes that differ in it.
    """
    return name.endswith("_seed") if type(value) is int else type(value) is float


def _value(text: str) -> Any:
    """Return what the rig will read; None for what it refuses."""
    try:
        return yamlfile.parse_value(text, yamlfile.Place(Path()))
    except RigError:
        return None


@lru_cache
def _names_and_numbers(path: str) -> tuple[frozenset[str], dict[str, float]]:
    """Return the names of a rig's blocks, and its own numbers; none of one that is not for lanes.

    A step of a user's may hang, which only a single run tells.
    """
    if not Path(path).resolve().is_relative_to(PLANTS):
        return frozenset(), {}
    try:
        config = load_rig(path, resolve=False).config
    except RigError:
        return frozenset(), {}
    blocks = frozenset(name for node in config.sections.values() for name in node.blocks)
    return blocks, {"rate_hz": config.rate_hz, "duration_s": config.duration_s}


def results(piece: Piece) -> list[CaseResult]:
    """Do a piece in this process."""
    found = _in_lanes(piece) if len(piece.own) > 1 else [None]
    return [made or alone(own.case) for own, made in zip(piece.own, found, strict=True)]


def _in_lanes(piece: Piece) -> list[CaseResult | None]:
    """Return the results of what lanes do; None for what is to be done alone."""
    from pcpc.executive.batch.runs import Case as Asked  # numba
    from pcpc.executive.nodes.watched import StepError

    try:
        bench = _bench(piece.common)
        rig = bench.runs.rig
        seeds = (rig.config.seed if own.seed is None else own.seed for own in piece.own)
        cases = [Asked(seed, own.numbers) for seed, own in zip(seeds, piece.own, strict=True)]
        done = bench.runs.done(cases)
    except (RigError, StepError):
        return [None] * len(piece.own)
    found = list[CaseResult | None]()
    for own, one in zip(piece.own, done, strict=True):
        found.append(None)
        if one.log:
            with suppress(RigError):
                settings = settings_of(rig) | own.numbers
                found[-1] = _judged_result(own.case, bench.judge, one.log, settings)
    return found


@lru_cache(maxsize=1)  # alike cases come one after the other
def _bench(common: Common) -> "Bench":
    from pcpc.tools.study.engine import Bench  # numba

    names = ("executive:time.t_s", *common.traces)
    return Bench(Path(common.rig), common.controller, common.settings, names=names)


def alone(case: Case) -> CaseResult:
    """Do one case in this process."""
    from pcpc.executive.nodes.virtual import in_memory  # numba
    from pcpc.executive.nodes.watched import StepError
    from pcpc.tools.after.verdict.judge import Judge

    try:
        rig = load_rig(case.rig, case.controller, case.settings)
        log = in_memory(rig)
    except (RigError, StepError) as error:
        return CaseResult(case, failed=str(error) or "a step does not return")
    try:
        return _judged_result(case, Judge.of(rig), log, settings_of(rig))
    except RigError as error:
        return CaseResult(case, failed=str(error))


def _judged_result(
    case: Case, judge: "Judge", log: "Log", settings: Mapping[str, float]
) -> CaseResult:
    if judge.rig.evaluation is None:
        raise RigError(f"{case.rig}: names no evaluation file")
    metrics = judge.metrics(log, case.window_s)
    traces = _traces(judge.judged(log).run(), case.traces) if case.traces else {}
    config = judge.rig.config
    expected = round(config.duration_s * config.rate_hz)
    early = len(log.node["executive"].cycle) < expected
    return CaseResult(case, metrics, traces, settings, diverged=early)


def settings_of(rig: Rig) -> dict[str, float]:
    """Return the settings of all blocks of a rig, as BLOCK.NAME."""
    specs = (spec for node in rig.nodes().values() for spec in node.blocks)
    return {f"{spec.name}.{name}": v for spec in specs for name, v in spec.settings.items()}


def _traces(run: Run, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Return variables and signals over the executive's cycles, thinned, and `t`."""
    step = max(1, len(run.cycle) // TRACE_POINTS)
    columns = {"t": run["executive:time.t_s"]} | {name: run.get(name) for name in names}
    return {name: values[::step].copy() for name, values in columns.items()}
