"""Faults on purpose, as a log holds them: what began when, and which missing frames they excuse.

Only faults of frames, floods and stalls let frames be missing, never a wrong value; and only while
they are on and for `EXCUSED_CYCLES` after. What is missing at other times counts as in any run.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.tools.verdict.outcome import HEALTH

EXCUSED_CYCLES = 20  # as in `loop.injected_frames`, which imports numba
EARLY_CYCLES = 2  # the cycles of two nodes on clocks of their own may be that far apart


def begun(log: logs.Log) -> list[str]:
    """Return what faults on purpose began, by time, and how often."""
    times: dict[str, list[float]] = {}
    for node in log.node.values():
        own: dict[str, list[float]] = {}
        for fault, cycle, left, about in settings(node):
            if left > 0.0:
                later = bool(about.get("next_cycle"))
                own.setdefault(fault, []).append((cycle + later) * 1e-9 * _period_ns(node))
        times |= {name: min(found, times.get(name, found)) for name, found in own.items()}
    return [
        f"{name} at {min(found):.4g} s" + (f", {len(found)} times" if len(found) > 1 else "")
        for name, found in sorted(times.items(), key=lambda pair: min(pair[1]))
    ]


def missing(log: logs.Log, health: Mapping[str, Mapping[str, int]]) -> bool:
    """Return whether frames are missing that nothing took on purpose; `health`: at the end."""
    spans = _excused(log)
    for role, counters in health.items():
        node = log.node.get(role)
        lost, taken, stale = (
            _rise(node, f"health.{HEALTH[key][1]}", counters.get(key, 0), spans)
            for key in ("lost", "lost_on_purpose", "stale")
        )
        if lost > taken or stale > 0.0:
            return True
    return False


def _rise(node: logs.Node | None, name: str, end: int, spans: NDArray[np.float64]) -> float:
    """Return by how much a counter, which is `end` at last, rose outside the spans of cycles."""
    if node is None or name not in node.timing or not len(node.cycle) or not len(spans):
        return float(end)
    counts = np.concatenate([[0.0], node.timing[name], [max(end, node.timing[name][-1])]])
    cycle = np.concatenate([[0.0], node.cycle, node.cycle[-1:] + 1.0])  # of each count
    at = np.searchsorted(spans[:, 0], cycle[1:], side="right") - 1
    excused = (at >= 0) & (spans[np.maximum(at, 0), 1] >= cycle[:-1])
    return float(np.diff(counts)[~excused].sum())


def _excused(log: logs.Log) -> NDArray[np.float64]:
    """Return (n, 2) first and last cycles of the spans in which frames may be missing, apart."""
    spans: list[tuple[float, float]] = []
    for node in log.node.values():
        on: dict[str, float] = {}  # faults that are on -> the cycle in which they began
        until: dict[str, float] = {}
        for fault, cycle, left, about in settings(node):
            if not about.get("of_frames"):
                continue
            if fault in on:
                spans.append((on.pop(fault), min(until[fault], cycle)))
            if left > 0.0:
                on[fault], until[fault] = cycle, cycle + left
        spans += [(start, until[fault]) for fault, start in on.items()]
    merged: list[list[float]] = []
    for start, end in sorted(spans):
        start, end = start - EARLY_CYCLES, end + EXCUSED_CYCLES
        if merged and start <= merged[-1][1]:
            merged[-1][1] = max(merged[-1][1], end)
        else:
            merged.append([start, end])
    return np.array(merged).reshape(-1, 2)


def settings(node: logs.Node) -> Iterator[tuple[str, int, float, Mapping[str, Any]]]:
    """Yield fault, cycle, for how many it is on from there, and what is known of it."""
    known = node.description.get("faults", {})
    for tuning in node.tunings:
        first, _, rest = str(tuning.get("name")).partition(".")
        fault, _, what = rest.partition(".")
        if (first, what) == ("fault", "left"):
            value = float(tuning.get("value", math.nan))
            yield fault, int(tuning["cycle"]), value, known.get(fault, {})


def _period_ns(node: logs.Node) -> float:
    return float(node.description["period_ns"])
