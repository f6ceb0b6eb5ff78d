"""What a run came to: metrics, timing, frames, verdict; as a table, as summary.json, as a figure.

verdict              exit code
ok                   0
expectation not met  1    a metric is outside the rig's two-sided limits
loss                 3    frames lost (but not on purpose) or stale, records dropped, or a part of
                          the log missing
safety stop          5    a node faulted or died
interrupted          130  Ctrl-C
"""

import importlib.util
import json
import math
import re
import shutil
import signal
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from executive import logs
from executive import shared as sh
from executive.rig import Rig
from tools.latest import latest_cycles, level

CODES = {"ok": 0, "expectation not met": 1, "loss": 3, "safety stop": 5, "interrupted": 130}
_PERCENTILES = (50.0, 90.0, 99.0, 99.9, 100.0)
LATEST_SHOWN = 3  # of those in summary.json
_STAGES = ("wake_late", "receive", "step", "send", "publish")


@dataclass
class Outcome:
    """What the host knows about a run beyond its log."""

    pacing: str
    bus: str
    interrupted: bool = False
    faults: list[str] = field(default_factory=list)
    changed: bool = (
        False  # values were set on the command line: the rig's expectations do not apply
    )
    realtime: bool | None = None
    begin_ns: int | None = None  # monotonic, of the command; None in virtual time
    dropped: int = 0
    cycles: int = 0
    latest: list[dict[str, Any]] = field(default_factory=list)
    nodes: list[str] = field(default_factory=list)  # seen here, so they have to be in the log

    def judge(self, name: str, code: int, block: sh.Shared | None) -> None:
        """Note the fault or death of process `name`, and what a node's rings dropped."""
        cycle = "" if block is None else f"cycle {int(block['control'][sh.CYCLE])}"
        if block is not None and block["control"][sh.FAULT]:
            reason = block.description["fault_names"][int(block["control"][sh.FAULT])]
            self.faults.append(f"{name}: {reason}, {cycle}")
        elif code < 0:
            killer = f"{name}: ended by {signal.Signals(-code).name}"
            self.faults.append(f"{killer} in {cycle}" if cycle else killer)
        elif code == 1:
            self.faults.append(f"{name}: failed, see its traceback above")
        if block is not None:
            self.nodes.append(name)
            rings = [block[f"{ring}_ends"] for ring in ("record", "frame", "event")]
            self.dropped += sum(int(ends[sh.DROPPED]) for ends in rings)
            if name == "executive":
                self.latest = latest_cycles(block)
                self.cycles = int(block["control"][sh.CYCLE]) + 1
                self.realtime = bool(block["control"][sh.REALTIME])


def summarise(
    rig: Rig, log: logs.Log, outcome: Outcome, end: logs.Log | None = None
) -> dict[str, Any]:
    """Return the content of summary.json; `end`: the last piece, where `log` does not reach it."""
    executive = log.node.get("executive")
    end = end or log
    health = _health(end)
    metrics, limits = _metrics(rig, log), rig.config.timing
    kept_back = rig.config.record.keep is not None
    failed = [] if outcome.changed or kept_back else _failed(rig, metrics)
    timing, share = level(executive.timing if executive else {}, rig.config.rate_hz, limits)
    if timing == "ERROR":
        failed.append(
            f"lateness and work at p99.9 are {share:.2f} of a period, limit {limits.error}"
        )
    absent = [f"{name}: not in the log" for name in outcome.nodes if name not in log.node]
    summary: dict[str, Any] = {
        "rig": rig.config.rig,
        "title": rig.config.title,
        "controller": rig.config.controller,
        "pacing": outcome.pacing,
        "bus": outcome.bus,
        "seed": rig.config.seed,
        "rate_hz": rig.config.rate_hz,
        "cycles": max(_cycles(end.node.get("executive")), outcome.cycles),
        "late_cycles": health.pop("late_cycles"),
        "skipped_cycles": health.pop("skipped_cycles"),
        "held_cycles": health.pop("held_cycles"),
        "metrics": metrics,
        "timing_us": _timing(executive, outcome),
        "timing_level": timing,
        "timing_share": round(share, 4),
        "latest_cycles": outcome.latest,
        "frames": health,
        "records": {
            "written": _written(log),
            "dropped": _dropped(log, outcome),
            **({"kept_back": True} if kept_back else {}),
        },
        "faults": outcome.faults,
        "expectations_failed": failed,
        "realtime": outcome.realtime,
        "start_to_first_cycle_s": _start_s(executive, outcome),
        "log_missing": [*log.missing, *absent],
    }
    summary["verdict"] = _verdict(summary, outcome)
    return summary


def _cycles(executive: logs.Node | None) -> int:
    return 0 if executive is None or not len(executive.cycle) else int(executive.cycle[-1]) + 1


def _start_s(executive: logs.Node | None, outcome: Outcome) -> float | None:
    """Return the time from the command to the executive's first cycle."""
    if executive is None or outcome.begin_ns is None or not len(executive.stamp_ns):
        return None
    return round(1e-9 * (int(executive.stamp_ns[0]) - outcome.begin_ns), 2)


def _verdict(summary: Mapping[str, Any], outcome: Outcome) -> str:
    if outcome.interrupted:
        return "interrupted"
    if outcome.faults:
        return "safety stop"
    frames = summary["frames"]
    astray = frames["lost"] > frames["lost_on_purpose"]  # counted when a later frame comes
    lost = astray or frames["stale"] or summary["records"]["dropped"]
    if lost or summary["log_missing"]:
        return "loss"
    return "expectation not met" if summary["expectations_failed"] else "ok"


def _last(values: NDArray[np.float64] | None) -> int:
    return int(values[-1]) if values is not None and len(values) else 0


def _health(log: logs.Log) -> dict[str, int]:
    """Return the counters of both nodes; frames of both directions are added."""
    total = dict.fromkeys(
        ("late_cycles", "skipped_cycles", "held_cycles", "sent", "received", "lost", "stale",
         "crc_errors",
         "repeated", "saturated_values", "lost_on_purpose"), 0)  # fmt: skip
    names = {
        "late_cycles": "late_cycles", "skipped_cycles": "skipped_cycles",
        "held_cycles": "held_cycles",
        "sent": "frames_sent", "received": "frames_received", "lost": "frames_lost",
        "stale": "stale_cycles", "crc_errors": "crc_errors", "repeated": "frames_repeated",
        "saturated_values": "saturated_values", "lost_on_purpose": "frames_lost_on_purpose",
    }  # fmt: skip
    for role, node in log.node.items():
        for key, name in names.items():
            if key.endswith("_cycles") and role != "executive":
                continue
            total[key] += _last(node.timing.get(f"health.{name}"))
    return total


def _timing(executive: logs.Node | None, outcome: Outcome) -> dict[str, dict[str, float]]:
    """Return percentiles of each stage, us; empty in virtual time."""
    if executive is None or outcome.pacing == "virtual" or not len(executive.cycle):
        return {}
    found: dict[str, dict[str, float]] = {}
    for stage in _STAGES:
        values = executive.timing[f"timing.{stage}_us"]
        points = np.percentile(values, _PERCENTILES)
        found[stage] = {f"p{p:g}" if p < 100 else "max": round(float(v), 2)
                        for p, v in zip(_PERCENTILES, points, strict=True)}  # fmt: skip
    return found


def _dropped(log: logs.Log, outcome: Outcome) -> int:
    """Return the rows that found a ring full: as the recorder counted, if it came to its end."""
    counts = {k: int(v) for k, v in log.metadata.get("run", {}).items() if k.startswith("dropped.")}
    return max(sum(counts.values()), outcome.dropped)


def _written(log: logs.Log) -> int:
    """Return the cycles in the log: as the recorder counted, if it came to its end."""
    run = log.metadata.get("run", {})
    counts = [int(n) for k, n in run.items() if re.fullmatch(r"written\..*\.record", k)]
    if counts and run.get("discarded", "0") == "0":
        return sum(counts)
    return sum(len(node.cycle) for node in log.node.values())


def evaluation_module(rig: Rig) -> ModuleType | None:
    """Import the rig's evaluation file, if it names one."""
    if rig.evaluation is None:
        return None
    name = "pcpc_evaluation"
    spec = importlib.util.spec_from_file_location(name, rig.evaluation.file)
    assert spec is not None and spec.loader is not None, "a .py file has a loader"
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def _metrics(rig: Rig, log: logs.Log) -> dict[str, float]:
    module = evaluation_module(rig)
    if module is None or rig.evaluation is None:
        return {}
    found = module.metrics(
        log, rig.evaluation.window_s, rig.evaluation.numbers, 1.0 / rig.config.rate_hz
    )
    return {name: float(value) for name, value in found.items()}


def _failed(rig: Rig, metrics: Mapping[str, float]) -> list[str]:
    """Return a line for each expectation that is not met; a metric that is missing is not met."""
    lines = []
    for name, (low, high) in rig.config.expect.get(rig.config.controller, {}).items():
        value = metrics.get(name, math.nan)
        if not low <= value <= high:
            lines.append(f"{name} = {value:.4g} is outside {low:g}..{high:g}")
    return lines


def write_json(summary: Mapping[str, Any], path: Path) -> str:
    """Write summary.json (no NaN or infinity: null) and return its text."""
    text = json.dumps(_finite(summary), indent=2)
    path.write_text(text + "\n")
    return text


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(child) for child in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def draw(rig: Rig, log: logs.Log, metrics: Mapping[str, float], path: Path) -> str:
    """Draw the rig's figure; return "" or the reason why there is none."""
    module = evaluation_module(rig)
    if module is None or rig.evaluation is None or not hasattr(module, "figure"):
        return "the rig names no evaluation file with a figure"
    title = f"{rig.config.rig}: {rig.config.title}, controller {rig.config.controller}"
    try:
        module.figure(log, path, title, metrics, rig.evaluation.window_s)
    except ImportError as error:
        return str(error)
    return ""


def show(summary: Mapping[str, Any], folder: Path) -> None:
    """Print the summary as a table on stdout."""
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold")
    table.add_column()
    kind = (
        ""
        if summary["realtime"] is None
        else (", real-time" if summary["realtime"] else ", not real-time")
    )
    table.add_row("rig", f"{summary['rig']}: {summary['title']}")
    table.add_row(
        "run",
        f"{summary['controller']}, {summary['pacing']}, {summary['bus']}, "
        f"seed {summary['seed']}{kind}",
    )
    for name, value in summary["metrics"].items():
        table.add_row(name, f"{value:.4g}")
    cycles = f"{summary['cycles']} at {summary['rate_hz']:g} Hz; late {summary['late_cycles']}, "
    table.add_row(
        "cycles", f"{cycles}skipped {summary['skipped_cycles']}, held {summary['held_cycles']}"
    )
    for stage, points in summary["timing_us"].items():
        table.add_row(
            f"{stage} us", "  ".join(f"{name} {value:g}" for name, value in points.items())
        )
    if summary["timing_us"]:
        share = f"lateness and work at p99.9: {summary['timing_share']:.1%} of a period"
        table.add_row("timing", f"{summary['timing_level']}; {share}")
    for worst in summary["latest_cycles"][:LATEST_SHOWN]:
        at = f"cycle {worst['cycle']}, {worst['wake_late_us']:g} us: {worst['cause']}"
        table.add_row("latest", at)
    table.add_row(
        "frames", "  ".join(f"{name} {value}" for name, value in summary["frames"].items())
    )
    table.add_row(
        "records", "  ".join(f"{name} {value}" for name, value in summary["records"].items())
    )
    for line in (*summary["faults"], *summary["expectations_failed"], *summary["log_missing"]):
        table.add_row("problem", line)
    table.add_row("verdict", summary["verdict"])
    table.add_row("folder", str(folder))
    Console(highlight=False, width=max(shutil.get_terminal_size().columns, 120)).print(table)
