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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.tools.machine.jitter import nines
from pcpc.tools.machine.jitter.loops import Loop, Setup
from pcpc.tools.machine.jitter.probe import STAGES, Node, Probe, join_rounds

PERCENTILES = {"p50": 50.0, "p90": 90.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}
COMPARED = ("p50", "p99", "max")
PCPC = "pcpc"
LEAST_CYCLES = 10  # of a round that has figures
_CLOCK_SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")

Vector = NDArray[np.float64]


@dataclass
class Result:
    """All rounds so far; `yardsticks` by name, as many rounds as there were."""

    setup: Setup
    rounds: int
    probes: list[Probe] = field(default_factory=list)
    yardsticks: dict[str, list[Loop]] = field(default_factory=dict)
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

    def node(self, name: str) -> Node | None:
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


def ratios(ours: Sequence[Vector], theirs: Sequence[Vector]) -> dict[str, dict[str, Any]]:
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
        figure: {
            "median": float(np.median(values)), "min": min(values), "max": max(values),
            "rounds": values,
        }
        for figure, values in each.items()
    }  # fmt: skip


def as_json(result: Result) -> dict[str, Any]:
    """Return everything as one JSON object; times in us."""
    setup = result.setup
    metadata = next((probe.metadata for probe in result.probes if probe.metadata), {})
    loops = {name: np.concatenate(result.late_us(name)) for name in result.loops}
    return {
        "interval_us": setup.interval_ns / 1000.0,
        "periods_per_round": setup.periods,
        "rounds": result.rounds,
        "priority": setup.priority,
        "cpus": list(setup.cpus),
        "bus": result.probes[0].bus if result.probes else setup.bus,
        "interrupted": result.interrupted,
        "fifo": result.fifo,
        "absent": result.absent,
        "kernel": f"{platform.system()} {platform.release()}",
        "clock_source": _CLOCK_SOURCE.read_text().strip() if _CLOCK_SOURCE.exists() else "unknown",
        "machine": metadata,
        "nodes": {n: _node_json(node) for n in ("executive", "plant") if (node := result.node(n))},
        "loops": {
            name: percentiles(values) | {"cycles": len(values)}
            for name, values in loops.items()
            if len(values)
        },
        "histogram_us": {name: histogram(values) for name, values in loops.items()},
        **nines.as_json(result.sorted_paths, result.verdicts),
        "per_round": [_round_json(result, i) for i in range(len(result.probes))],
        "ratio": {
            name: ratios(result.late_us(PCPC), result.late_us(name)) for name in result.loops[1:]
        },
    }


def _node_json(node: Node) -> dict[str, Any]:
    stages = {s: percentiles(node.stages_us[s]) for s in STAGES if len(node.stages_us[s])}
    return {
        "cycles": node.cycles, "missed": node.missed, "late": node.late, "stages": stages,
    }  # fmt: skip


def _round_json(result: Result, number: int) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in result.loops:
        rounds = result.late_us(name)
        if number < len(rounds) and len(rounds[number]):
            found[name] = percentiles(rounds[number]) | {"cycles": len(rounds[number])}
    nodes = result.probes[number].nodes
    return {"loops": found, "nodes": {name: _node_json(node) for name, node in nodes.items()}}
