"""What the page shows of a run besides curves: states, faults, timing, frames, parameters."""

import math
import time
from typing import Any

from pcpc.executive.loop.faults import reason
from pcpc.executive.loop.timing_layout import BUCKETS, Stage
from pcpc.executive.nodes import injecting, operating
from pcpc.executive.nodes.live import CycleValues, Live
from pcpc.executive.nodes.mailbox import LEVELS, level_of
from pcpc.tools.live.host.sources import RunSource, full
from pcpc.tools.live.host.traffic import load

_COUNTERS = {
    "late": "late", "skipped": "skipped", "held": "held", "lost": "lost",
    "crc": "crc_errors", "repeated": "repeated", "sequence": "wrong_sequence",
    "foreign": "foreign", "intrusions": "intrusions", "send errors": "send_errors",
    "bus errors": "bus_errors", "refused": "refused",
}  # fmt: skip
_TIMES = ("wake_late_p50_us", "wake_late_p99_us", "wake_late_max_us", "work_p99_us")
_PERIODS = 8  # of the histogram: buckets to an octave


def run_facts(source: RunSource, write: bool) -> dict[str, Any]:
    """Return what does not change while a run is shown: its nodes and their variables."""
    running = {role: node.live for role, node in source.nodes.items() if source.live}
    faults = injecting.faults_of([*running.values()]) if running else []
    return {
        "rig": source.rig, "live": source.live, "run": source.number, "write": write,
        "note": source.note,
        "period_s": source.period_s,
        "nodes": {role: _variables(node, role) for role, node in source.nodes.items()},
        "faults": [{"name": one.name, "about": one.about, "node": one.node} for one in faults],
        "laws": operating.laws(running["executive"]) if "executive" in running else [],
    }  # fmt: skip


def _variables(node: Any, role: str) -> list[dict[str, Any]]:
    recorded = set(node.names)
    return [
        {
            "name": full(role, name),
            "unit": variable.unit,
            "help": variable.help,
            "kind": variable.kind,
            "range": variable.range and [_number(x) for x in variable.range],
            "plot": name in recorded,
        }
        for name, variable in node.variables.items()
        if name in recorded or variable.range is not None
    ]


def _number(value: float) -> float | None:
    """Return what JSON can hold."""
    return float(value) if math.isfinite(value) else None


class Status:
    """The changing part of a running source, which all clients are told."""

    def __init__(self) -> None:
        self._passes: dict[tuple[int, str], tuple[float, int]] = {}

    def of(self, source: RunSource) -> tuple[dict[str, Any], dict[str, float | None]]:
        """Return states, counters, times, histogram, frames, load; and parameters."""
        nodes, values = {}, dict[str, float | None]()
        for role, node in source.nodes.items():
            now = node.live.read()
            nodes[role] = self._node((source.number, role), node.live, now)
            nodes[role]["frames"] = [
                {"id": kind.number, "name": kind.name, "way": kind.way}
                | {"signals": {signal: _number(now[name]) for signal, name in kind.signals.items()}}
                | node.traffic.timed(kind.number, kind.way)
                for kind in node.traffic.kinds
            ]
            values |= {
                full(role, name): _number(now[name])
                for name, one in node.variables.items()
                if one.range is not None
            }
        return {"nodes": nodes, "load": load(source.nodes)}, values

    def _node(self, key: tuple[int, str], live: Live, now: CycleValues) -> dict[str, Any]:
        block, description = live.block, live.block.description
        control = block.control
        state = str(description["state_names"][int(control.state)])
        return {
            "state": state if live.running else "ended",
            "fault": reason(description, control) if control.fault else "",
            "cycle": now.cycle, "t_s": now.cycle * 1e-9 * live.period_ns,
            "rate_hz": self._rate(key, int(control.passes)),
            "pacing": description["metadata"].get("pacing", ""),
            "counters": {name: int(control[word]) for name, word in _COUNTERS.items()},
            "times": {name: _number(now[f"timing.{name}"]) for name in _TIMES},
            "late": _octaves(block["histogram"][Stage.WAKE_LATE]),
            "locked": LEVELS.index(level_of(block)),
            "armed": now[operating.DISARMED] == 0.0, "in_charge": operating.in_charge(live, now),
        }  # fmt: skip

    def _rate(self, key: tuple[int, str], passes: int) -> float:
        now_s = time.monotonic()
        then_s, before = self._passes.get(key, (now_s - 1.0, passes))
        if now_s - then_s >= 1.0 or key not in self._passes:
            self._passes[key] = now_s, passes
        return max(0.0, (passes - before) / max(now_s - then_s, 1e-3))


def _octaves(histogram: Any) -> list[list[float]]:
    """Return how many cycles woke later than 2^i ns and not than 2^(i + 1), as [us, count]."""
    counts = [[16e-3, float(histogram[:16].sum())]]
    for at in range(16, BUCKETS, _PERIODS):
        end_us = 1e-3 * 2 ** (5 + (at - 16) // _PERIODS)
        counts.append([end_us, float(histogram[at : at + _PERIODS].sum())])
    used = [i for i, (_, count) in enumerate(counts) if count]
    return counts[used[0] : used[-1] + 1] if used else []
