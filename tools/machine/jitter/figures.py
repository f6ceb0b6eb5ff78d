"""What `pcpc jitter` makes of its rounds: percentiles, histograms, ratios, one JSON object.

    ratio of a figure to a loop    ours / its, of rounds that follow each other; then the median,
                                   the least and the largest over the rounds

Lateness is that of the executive's wake-up; times in us, percentiles as numpy's, interpolated.
"""

import platform
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from pcpc.tools.machine.jitter import nines
from pcpc.tools.machine.jitter.loops import NAMES, Setup, TimedLoop
from pcpc.tools.machine.jitter.probe import ROLES, STAGES, Probe, ProbedNode, join_rounds
from pcpc.tools.terminal.answer import Count, Positive, one_of

PERCENTILES = {"p50": 50.0, "p90": 90.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}
COMPARED = ("p50", "p99", "max")
PCPC = "pcpc"
LEAST_CYCLES = 10  # of a round that has figures
_CLOCK_SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")

Vector = NDArray[np.float64]
AnyLoop = Annotated[str, one_of(PCPC, *NAMES)]
NodeRole = Annotated[str, one_of(*ROLES)]
_Compared = Annotated[str, one_of(*COMPARED)]
_ALL_OR_NONE = Meta(extra_json_schema={"dependentRequired": {one: [*COMPARED] for one in COMPARED}})
_WHOLE = Meta(extra_json_schema={"propertyNames": {"pattern": "^-?[0-9]+$"}})


class Percentiles(Struct):
    """Of times."""

    p50: float
    "us"
    p90: float
    "us"
    p99: float
    "us"
    p99_9: float = msgspec.field(name="p99.9")
    "us"
    max: float
    "us"


class Lateness(Percentiles):
    """Of the wake-up."""

    cycles: Positive


class NodeFigures(Struct):
    """What a node did in time."""

    cycles: Count
    missed: Count
    "periods"
    late: Count
    "cycles"
    stages: dict[str, Percentiles]
    "by stage of a cycle"


class Round(Struct):
    """A round."""

    loops: dict[AnyLoop, Lateness]
    nodes: dict[NodeRole, NodeFigures]


class Ratio(Struct):
    """Ours over the other's, of rounds that follow each other."""

    median: float
    min: float
    max: float
    rounds: list[float]


class Figures(Struct):
    """What `--json` writes to its file."""

    interval_us: float
    "period, us"
    periods_per_round: Positive
    rounds: Positive
    "that were asked for"
    priority: int
    cpus: list[Count]
    bus: str
    interrupted: bool
    fifo: dict[AnyLoop, bool]
    "whether SCHED_FIFO was granted, by loop"
    absent: dict[AnyLoop, str]
    "loops that could not be measured, and why"
    kernel: str
    clock_source: str
    machine: dict[str, str]
    "versions, machine, clocks and rig, as in a log"
    nodes: dict[NodeRole, NodeFigures]
    "of all rounds"
    loops: dict[AnyLoop, Lateness]
    "of all rounds"
    histogram_us: dict[AnyLoop, Annotated[dict[int, Positive], _WHOLE]]
    "by loop: how often each whole us, rounded down, came"
    nines_us: dict[nines.Way, nines.Quantiles]
    "by what is timed, and percent; empty: nothing was"
    limits: list[nines.Limit]
    per_round: list[Round]
    ratio: dict[Annotated[str, one_of(*NAMES)], Annotated[dict[_Compared, Ratio], _ALL_OR_NONE]]
    "by loop, and percentile; empty: no round has both"


@dataclass
class JitterResult:
    """All rounds so far; `yardsticks` by name, as many rounds as there were."""

    setup: Setup
    rounds: int
    probes: list[Probe] = field(default_factory=list)
    yardsticks: dict[str, list[TimedLoop]] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)
    interrupted: bool = False
    limits: dict[tuple[str, Fraction], float] = field(default_factory=dict)  # us, by way and %
    limits_of: str = ""  # the file

    @cached_property
    def sorted_paths(self) -> dict[str, Vector]:
        """The times of `nines.WAYS`, once all rounds are measured; none without any.

        Each (periods,).
        """
        node = self.node("executive")
        paths = {way: np.sort(times) for way, times in node.paths_us.items()} if node else {}
        return paths if all(map(len, paths.values())) else {}

    @cached_property
    def verdicts(self) -> list[nines.Judged]:
        """What became of each limit."""
        return nines.verdicts(self.sorted_paths, self.limits)

    def node(self, name: str) -> ProbedNode | None:
        """Return all rounds of a node as one, None if there is none."""
        found = [probe.nodes[name] for probe in self.probes if name in probe.nodes]
        return join_rounds(found) if found else None

    def late_us(self, loop: str) -> list[Vector]:
        """Return the lateness of a loop, us, one array a round. Each (cycles,)."""
        if loop == PCPC:
            nodes = [probe.nodes.get("executive") for probe in self.probes]
            return [np.empty(0) if n is None else n.stages_us["wake_late"] for n in nodes]
        return [np.divide(one.late_ns, 1000.0) for one in self.yardsticks[loop]]

    @property
    def loops(self) -> list[str]:
        """Names of all loops that were measured, ours first."""
        return [PCPC, *(name for name, rounds in self.yardsticks.items() if rounds)]

    @property
    def fifo(self) -> dict[str, bool]:
        """Whether SCHED_FIFO was granted, by loop, in all its rounds."""
        own = {PCPC: all(probe.fifo for probe in self.probes)}
        return own | {
            name: all(loop.fifo for loop in rounds) for name, rounds in self.yardsticks.items()
        }


def percentiles(values: Vector) -> dict[str, float]:
    """Return p50 to max of at least one value. `values`: (n,)."""
    points = np.percentile(values, list(PERCENTILES.values()))
    return {name: float(v) for name, v in zip(PERCENTILES, points, strict=True)}


def histogram(values_us: Vector) -> dict[int, int]:
    """Return how often each whole us, rounded down as cyclictest does, came; ascending.

    `values_us`: (n,).
    """
    us, counts = np.unique(np.floor(values_us).astype(np.int64), return_counts=True)
    return {int(u): int(n) for u, n in zip(us, counts, strict=True)}


def ratios(ours: Sequence[Vector], theirs: Sequence[Vector]) -> dict[str, Ratio]:
    """Return median, min, max and each round's ratio of each compared figure; {} without rounds.

    Each round: (n,).
    """
    pairs = [
        (percentiles(a), percentiles(b))
        for a, b in zip(ours, theirs, strict=False)  # an interrupted run has a round less of one
        if min(len(a), len(b)) >= LEAST_CYCLES
    ]
    each = {figure: [a[figure] / b[figure] for a, b in pairs] for figure in COMPARED if pairs}
    return {
        figure: Ratio(float(np.median(values)), min(values), max(values), values)
        for figure, values in each.items()
    }


def figures(result: JitterResult) -> Figures:
    """Return all that was measured in at least one round; times in us."""
    setup = result.setup
    metadata = next((probe.metadata for probe in result.probes if probe.metadata), {})
    loops = {name: np.concatenate(result.late_us(name)) for name in result.loops}
    return Figures(
        interval_us=setup.interval_ns / 1000.0,
        periods_per_round=setup.periods,
        rounds=result.rounds,
        priority=setup.priority,
        cpus=list(setup.cpus),
        bus=result.probes[0].bus,
        interrupted=result.interrupted,
        fifo=result.fifo,
        absent=result.absent,
        kernel=f"{platform.system()} {platform.release()}",
        clock_source=_CLOCK_SOURCE.read_text().strip() if _CLOCK_SOURCE.exists() else "unknown",
        machine=metadata,
        nodes={name: _node(node) for name in ROLES if (node := result.node(name))},
        loops={name: _lateness(values) for name, values in loops.items() if len(values)},
        histogram_us={name: histogram(values) for name, values in loops.items()},
        nines_us=nines.quantiles(result.sorted_paths),
        limits=nines.limits(result.verdicts),
        per_round=[_round(result, i) for i in range(len(result.probes))],
        ratio={
            name: ratios(result.late_us(PCPC), result.late_us(name)) for name in result.loops[1:]
        },
    )


def _lateness(values: Vector) -> Lateness:
    return msgspec.convert(percentiles(values) | {"cycles": len(values)}, Lateness)


def _node(node: ProbedNode) -> NodeFigures:
    us = node.stages_us
    stages = {s: msgspec.convert(percentiles(us[s]), Percentiles) for s in STAGES if len(us[s])}
    return NodeFigures(node.cycles, node.missed, node.late, stages)


def _round(result: JitterResult, number: int) -> Round:
    found = {}
    for name in result.loops:
        rounds = result.late_us(name)
        if number < len(rounds) and len(rounds[number]):
            found[name] = _lateness(rounds[number])
    nodes = result.probes[number].nodes
    return Round(found, {name: _node(node) for name, node in nodes.items()})
