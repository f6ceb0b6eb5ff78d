"""Faults on purpose, as a log holds them: what began when, and what they excuse.

What faults at a receiver took, and what a node that stands still without a clock did not send, the
loop counts frame by frame (`executive.loop.on_wire`), and excuses nothing else. On a clock nobody
knows of the other node's stall; its cycles are those in which the others may be without input. A
flood takes no frame: what does not come because of it is missing.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.verdict.outcome import HEALTH

EARLY_CYCLES = 2  # the cycles of two nodes on clocks of their own may be that far apart


def started_faults(log: logs.Log) -> list[str]:
    """Return what faults on purpose began, by time, and how often."""
    times: dict[str, list[float]] = {}
    for node in log.node.values():
        of_node: dict[str, list[float]] = {}
        for fault, cycle, left, about in fault_settings(node):
            if left > 0.0:
                later = bool(about.get("next_cycle"))
                of_node.setdefault(fault, []).append((cycle + later) * 1e-9 * _period_ns(node))
        times |= {name: min(found, times.get(name, found)) for name, found in of_node.items()}
    return [
        f"{name} at {min(found):.4g} s" + (f", {len(found)} times" if len(found) > 1 else "")
        for name, found in sorted(times.items(), key=lambda pair: min(pair[1]))
    ]


def missing_input(log: logs.Log, health: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Return a line for each node whose input is missing and was not taken on purpose.

    `health`: at the end.
    """
    lines = []
    for role, counters in health.items():
        node, frames, cycles = log.node.get(role), "missed", "starved"
        if node is not None and f"health.{HEALTH['missed'][1]}" not in node.timing:
            frames, cycles = "lost", "stale"  # of an older log
        gone = counters.get(frames, 0)
        gone -= counters.get("lost_on_purpose", 0) if frames == "lost" else 0
        without = counters.get(cycles, 0)
        if cycles == "starved" and not _starved(log, role, without):
            without = 0
        counts = [f"{gone:,} frames lost"] * (gone > 0)
        counts += [f"{without:,} cycles with stale input"] * (without > 0)
        if counts:
            lines.append(f"{role}: {', '.join(counts)}{_first(node, frames, cycles)}")
    return lines


def _first(node: logs.NodeLog | None, *counts: str) -> str:
    """Return when a node counted the first of these; "" where no record tells."""
    columns = [node.timing.get(f"health.{HEALTH[key][1]}") for key in counts] if node else []
    rows = [int(np.argmax(one > 0.0)) for one in columns if one is not None and one.any()]
    if not node or not rows:
        return ""
    at = int(node.cycle[min(rows)])
    return f", first at {at * 1e-9 * _period_ns(node):.4g} s"


def missed_by_the_machine(rig: Rig, log: logs.Log, health: Mapping[str, int]) -> tuple[int, int]:
    """Return how many of the executive's periods were skipped, and had a held input.

    Those in which it stood still on purpose are no such ones. Where frames were taken on purpose
    nobody knows of the held ones.
    """
    leader = log.node.get("executive")
    if leader is None:
        return 0, 0
    stalls = [(a, b) for _, a, b, about in fault_spans(leader) if about.get("kind") == "stall"]
    skipped = health.get("skipped_cycles", 0) - round(sum(end - start for start, end in stalls))
    taken = bool(rig.config.losses) or bool(started_faults(log))
    return max(skipped, 0), 0 if taken else health.get("held_cycles", 0)


def _starved(log: logs.Log, role: str, end: int) -> bool:
    """Return whether cycles missed, `end` at last, that no stall of another node explains."""
    node, spans = log.node.get(role), _stalls(log, role)
    name = f"health.{HEALTH['starved'][1]}"
    if node is None or name not in node.timing or not len(node.cycle) or not len(spans):
        return end > 0
    counts = np.concatenate([[0.0], node.timing[name], [max(end, node.timing[name][-1])]])
    cycle = np.concatenate([[0.0], node.cycle, node.cycle[-1:] + 1.0])  # of each count
    at = np.searchsorted(spans[:, 0], cycle[1:], side="right") - 1
    excused = (at >= 0) & (spans[np.maximum(at, 0), 1] >= cycle[:-1])
    return bool(np.diff(counts)[~excused].any())


def _stalls(log: logs.Log, role: str) -> NDArray[np.float64]:
    """Return (n, 2) first and last cycles in which others stood still unknown to a node, apart."""
    spans = [
        (start, end)
        for name, node in log.node.items()
        if name != role
        for fault, start, end, about in fault_spans(node)
        if about.get("kind") == "stall" and fault not in log.node[role].description["faults"]
    ]
    merged: list[list[float]] = []
    for start, end in sorted(spans):
        start, end = start - EARLY_CYCLES, end + EARLY_CYCLES
        if merged and start <= merged[-1][1]:
            merged[-1][1] = max(merged[-1][1], end)
        else:
            merged.append([start, end])
    return np.array(merged).reshape(-1, 2)


def fault_spans(node: logs.NodeLog) -> Iterator[tuple[str, float, float, Mapping[str, Any]]]:
    """Yield each fault, the cycles from which on it was set and was over, what is known of it."""
    on: dict[str, tuple[float, float, Mapping[str, Any]]] = {}
    for fault, cycle, left, known in fault_settings(node):
        if fault in on:
            begin, end, _ = on.pop(fault)
            yield fault, begin, min(end, cycle), known
        if left > 0.0:
            on[fault] = cycle, cycle + left, known
    for fault, span in on.items():
        yield fault, *span


def fault_settings(node: logs.NodeLog) -> Iterator[tuple[str, int, float, Mapping[str, Any]]]:
    """Yield fault, cycle, for how many it is on from there, and what is known of it."""
    known = node.description.get("faults", {})
    for tuning in node.tunings:
        first, _, rest = tuning["name"].partition(".")
        fault, _, what = rest.partition(".")
        if (first, what) == ("fault", "left"):
            yield fault, tuning["cycle"], float(tuning["value"]), known.get(fault, {})


def _period_ns(node: logs.NodeLog) -> float:
    return float(node.description["period_ns"])
