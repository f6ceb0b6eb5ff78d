"""The executive's latest cycles and what its timing comes to, for the summary."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.timing_layout import USAGE, Stage
from pcpc.executive.rig.schema import Timing

LEVEL_PERCENTILE = 99.9


def latest_cycles(block: sh.NodeMemory) -> list[dict[str, Any]]:
    """Return the cycles that woke latest, the latest first, with stages in us and a cause."""
    latest = []
    for row in np.array(block["latest"]):
        if row.stage_ns[Stage.WAKE_LATE] == 0:
            continue
        times = zip(Stage.words(), row.stage_ns.tolist(), strict=True)
        cycle: dict[str, Any] = {"cycle": int(row.cycle)}
        cycle |= {f"{stage}_us": round(ns / 1e3, 1) for stage, ns in times}
        cycle |= dict(zip(USAGE, row.usage.tolist(), strict=True))
        cycle["cause"] = cause(cycle, block.description["period_ns"] / 1e3)
        latest.append(cycle)
    return sorted(latest, key=lambda c: -c["wake_late_us"])


def cause(cycle: Mapping[str, Any], period_us: float) -> str:
    """Return in words what is known about why a cycle woke late."""
    if cycle["major_faults"]:
        return "pages were read from disk: lock memory (pcpc doctor)"
    if cycle["forced_switches"]:
        return "another process took the processor: raise the priority, or isolate a processor"
    if cycle["minor_faults"]:
        return f"{cycle['minor_faults']} page faults"
    if cycle["wake_late_us"] > period_us:
        return "the cycle before ran past its end, or the machine stalled"
    return "woken late by timer, interrupts or hypervisor"


def level(
    together: Mapping[str, float], rate_hz: float, limits: Timing, missed: Sequence[int], due: int
) -> tuple[str, float]:
    """Return OK, WARN or ERROR, and lateness plus work at p99.9 as a fraction of the period.

    `together`: percentiles of their sum, us, with a period for each one that was skipped; without
    any, OK and 0. `missed`: how many of the `due` periods were skipped, and had a held input. Any
    skipped one is a WARN, and so are more held ones than p99.9 leaves out; "not judged" without
    limits.
    """
    if limits.warn is None and limits.error is None:
        return "not judged", share_of(together, rate_hz)
    share, (skipped, held) = share_of(together, rate_hz), missed
    if limits.error is not None and share >= limits.error:
        return "ERROR", share
    many = skipped > 0 or held * round(100.0 / (100.0 - LEVEL_PERCENTILE)) > due
    if limits.warn is not None and together and (share >= limits.warn or many):
        return "WARN", share
    return "OK", share


def share_of(together: Mapping[str, float], rate_hz: float) -> float:
    """Return lateness plus work at p99.9 as a fraction of the period; 0 without any."""
    return together.get(f"p{LEVEL_PERCENTILE:g}", 0.0) * 1e-6 * rate_hz
