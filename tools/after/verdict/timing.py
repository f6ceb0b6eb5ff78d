"""What the stages of the executive's cycles took in a run, of its whole log."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from pcpc.executive.log import reader as logs
from pcpc.executive.log.distribution import Distribution
from pcpc.executive.log.long_logs import LongLog
from pcpc.executive.loop.timing_layout import Stage
from pcpc.tools.after.verdict.outcome import Outcome

TIMING_COLUMNS = (  # of every node: what a summary and the last axes of a figure are made of
    *(f"timing.{stage}_us" for stage in ("wake_late", "receive", "step", "send", "publish")),
    *(f"health.{name}" for name in (
        "late_cycles", "skipped_cycles", "held_cycles", "stale_cycles", "frames_sent",
        "frames_received", "frames_lost", "crc_errors", "frames_repeated", "saturated_values",
        "frames_lost_on_purpose",
    )),
)  # fmt: skip
_PERCENTILES = (50.0, 90.0, 99.0, 99.9, 100.0)
_STAGES = Stage.words()[: Stage.WORK]


def stage_percentiles(
    executive: logs.NodeLog | None, log: logs.Log, outcome: Outcome, skipped: int
) -> dict[str, dict[str, float]]:
    """Return percentiles of each stage and of lateness and work `together`, us; {} without a clock.

    Each of the `skipped` periods counts as one together. Of a log too long to be read whole to one
    part in a million.
    """
    if executive is None or outcome.pacing == "virtual":
        return {}
    percentiles: dict[str, Any] = {}
    if not all(f"timing.{stage}_us" in executive.timing for stage in _STAGES):
        return {}
    for part in parts(log):
        timing = {stage: part.timing[f"timing.{stage}_us"] for stage in _STAGES}
        timing["together"] = np.sum([timing[stage] for stage in _STAGES[:4]], axis=0)
        lost = min(skipped, len(part.cycle))  # half of all are enough
        period_us = 1e-3 * executive.description["period_ns"]
        timing["together"] = np.concatenate([timing["together"], np.full(lost, period_us)])
        skipped -= lost
        for stage, values in timing.items():
            if not isinstance(log, LongLog):
                percentiles[stage] = np.percentile(values, _PERCENTILES).tolist()
                continue
            percentiles.setdefault(stage, Distribution()).add(values)
    if isinstance(log, LongLog):
        percentiles = {
            k: [d.quantile(p / 100.0) for p in _PERCENTILES] for k, d in percentiles.items()
        }
    return {
        stage: {
            f"p{p:g}" if p < 100 else "max": value if stage == "together" else round(value, 2)
            for p, value in zip(_PERCENTILES, points, strict=True)
        }
        for stage, points in percentiles.items()
    }


def parts(log: logs.Log) -> Iterator[logs.NodeLog]:
    """Yield the executive's record, of a long log piece by piece."""
    if not isinstance(log, LongLog):
        yield log.node["executive"]
        return
    for part, begin, end in log.parts("executive"):
        node = part.node["executive"]
        columns = {k: node.timing[f"timing.{k}_us"][begin:end] for k in _STAGES}
        yield logs.NodeLog(
            node.cycle,
            node.stamp_ns,
            {},
            {f"timing.{k}_us": v for k, v in columns.items()},
            node.frames,
            [],
            [],
            {},
        )
