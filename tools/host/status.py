"""What the page shows of a run besides curves: states, faults, timing, frames, parameters."""

import math
import time
from collections.abc import Mapping
from typing import Any

from pcpc.drivers import can_id
from pcpc.executive.loop import faults
from pcpc.executive.loop import shared as sh
from pcpc.executive.nodes import injecting, operating
from pcpc.executive.nodes.live import Live, Values
from pcpc.tools.host.sources import Source, full
from pcpc.tools.host.traffic import Traffic, load

_COUNTERS = {
    "late": sh.LATE, "skipped": sh.SKIPPED, "held": sh.HELD, "lost": sh.LOST,
    "crc": sh.CRC_ERRORS, "repeated": sh.REPEATED, "sequence": sh.WRONG_SEQUENCE,
    "foreign": sh.FOREIGN, "intrusions": sh.INTRUSIONS, "send errors": sh.SEND_ERRORS,
    "bus errors": sh.BUS_ERRORS, "refused": sh.REFUSED,
}  # fmt: skip
_TIMES = ("wake_late_p50_us", "wake_late_p99_us", "wake_late_max_us", "work_p99_us")
_PERIODS = 8  # of the histogram: buckets to an octave


def about(source: Source, write: bool) -> dict[str, Any]:
    """Return what does not change while a run is shown: its nodes and their variables."""
    return {
        "rig": source.rig, "live": source.live, "run": source.number, "write": write,
        "period_s": source.period_s,
        "nodes": {role: _variables(node, role) for role, node in source.nodes.items()},
        "faults": _faults(source), "laws": _laws(source),
    }  # fmt: skip


def _variables(node: Any, role: str) -> list[dict[str, Any]]:
    recorded = set(node.names)
    return [
        {
            "name": full(role, name), "unit": one.unit, "help": one.help, "kind": one.kind,
            "range": one.range and [_number(x) for x in one.range], "plot": name in recorded,
        }
        for name, one in node.variables.items()
        if name in recorded or one.range is not None
    ]  # fmt: skip


def _laws(source: Source) -> list[str]:
    node = source.nodes.get("executive") if source.live else None
    return [] if node is None else operating.laws(node.live)


def _faults(source: Source) -> list[dict[str, Any]]:
    if not source.live:
        return []
    found = injecting.faults_of([node.live for node in source.nodes.values()])
    return [{"name": one.name, "about": one.about, "node": one.node} for one in found]


def _number(value: float) -> float | None:
    """Return what JSON can hold."""
    return float(value) if math.isfinite(value) else None


class Status:
    """The changing part of a running source; what has not changed is not told again."""

    def __init__(self) -> None:
        self._told: dict[str, float | None] = {}
        self._passes: dict[str, tuple[float, int]] = {}

    def message(self, source: Source) -> dict[str, Any]:
        """Return states, counters, times, histogram, frames, load; parameters that changed."""
        nodes, values = {}, dict[str, float | None]()
        for role, node in source.nodes.items():
            now = node.live.read()
            nodes[role] = self._node(role, node.live, now)
            nodes[role]["frames"] = _frames(
                node.live.block.description["frames"], now, node.traffic
            )
            values |= {
                full(role, name): _number(now[name])
                for name, one in node.variables.items() if one.range is not None
            }  # fmt: skip
        changed = {k: v for k, v in values.items() if self._told.get(k, math.inf) != v}
        self._told = values
        return {"nodes": nodes, "values": changed, "load": load(source.nodes)}

    def _node(self, role: str, live: Live, now: Values) -> dict[str, Any]:
        block, about = live.block, live.block.description
        control = block["control"]
        state = str(about["state_names"][int(control[sh.STATE])])
        return {
            "state": state if live.running else "ended",
            "fault": faults.reason(about, control) if control[sh.FAULT] else "",
            "cycle": now.cycle, "t_s": now.cycle * 1e-9 * live.period_ns,
            "rate_hz": self._rate(role, int(control[sh.PASSES])),
            "pacing": about["metadata"].get("pacing", ""),
            "counters": {name: int(control[word]) for name, word in _COUNTERS.items()},
            "times": {name: _number(now[f"timing.{name}"]) for name in _TIMES},
            "late": _octaves(block["histogram"][0]),
            "locked": int(block["mail"][sh.LOCK]),
            "armed": now[operating.DISARMED] == 0.0, "in_charge": operating.in_charge(live, now),
        }  # fmt: skip

    def _rate(self, role: str, passes: int) -> float:
        now_s = time.monotonic()
        then_s, before = self._passes.get(role, (now_s - 1.0, passes))
        if now_s - then_s >= 1.0 or role not in self._passes:
            self._passes[role] = now_s, passes
        return max(0.0, (passes - before) / max(now_s - then_s, 1e-3))


def _octaves(histogram: Any) -> list[list[float]]:
    """Return how many cycles woke later than 2^i ns and not than 2^(i + 1), as [us, count]."""
    counts = [[16e-3, float(histogram[:16].sum())]]
    for at in range(16, sh.BUCKETS, _PERIODS):
        end_us = 1e-3 * 2 ** (5 + (at - 16) // _PERIODS)
        counts.append([end_us, float(histogram[at : at + _PERIODS].sum())])
    used = [i for i, (_, count) in enumerate(counts) if count]
    return counts[used[0] : used[-1] + 1] if used else []


def _frames(names: Mapping[str, str], now: Values, traffic: Traffic) -> list[dict[str, Any]]:
    """Return the frames that a node knows, sent or received: newest signals, period, jitter."""
    found = []
    for word, name in names.items():
        for way in ("rx", "tx"):
            start = f"{way}.{name}."
            mine = [key for key in now if key.startswith(start)]
            if mine:
                signals = {key.removeprefix(start): _number(now[key]) for key in mine}
                number = int(word) & can_id.ID
                one = {"id": number, "name": name, "way": way, "signals": signals}
                found.append(one | traffic.timed(number, way))
    return found
