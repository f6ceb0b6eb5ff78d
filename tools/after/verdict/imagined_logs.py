"""A log as a run of a rig would leave it, without the run: to try out what judges it."""

import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.executive.log.long_logs import Columns
from pcpc.executive.nodes.plan import cycles_of, describe, plan
from pcpc.executive.rig.reading import Rig

MOST_CYCLES = 20_000
Vector = NDArray[np.float64]
Fill = Callable[[str, int], Vector]  # of a variable's name and the number of cycles


def nothing(name: str, cycles: int) -> Vector:
    """Return zeros. Shape (cycles,)."""
    return np.zeros(cycles)


def noise(name: str, cycles: int) -> Vector:
    """Return values from -2 to 2, others for each name. Shape (cycles,)."""
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    return rng.uniform(-2.0, 2.0, cycles)


def large(name: str, cycles: int) -> Vector:
    """Return values from 0 to 1e6. Shape (cycles,)."""
    return 5e5 * (1.0 + 0.5 * noise(name, cycles))


def imagined_log(rig: Rig, pacing: str, fill: Fill = nothing) -> logs.Log:
    """Return a log of all nodes with variables of `fill`; RigError, BusError as `plan`.

    As long as a run of the rig, of a long one with gaps.
    """
    total = cycles_of(rig)
    cycle = np.arange(total)
    if total > MOST_CYCLES:  # pieces of ten cycles all over the run
        starts = np.linspace(0, total - 10, MOST_CYCLES // 10).astype(np.int64)
        cycle = np.unique((starts[:, None] + np.arange(10)).ravel())
    attachments: dict[str, str] = {}
    nodes, metadata = {}, {}
    for role in rig.roles:
        facts = {"pacing": pacing, "rate_hz": repr(rig.config.rate_hz)}
        description = describe(plan(rig, role, pacing), facts, kept=False)

        def column(name: str) -> Vector:
            return fill(name, len(cycle))

        nodes[str(role)] = logs.NodeLog(
            cycle,
            cycle * description["period_ns"],
            Columns(description["state_columns"], column),
            Columns(description["timing_columns"], column),
            np.empty(0, logs.FRAME),
            [],
            [],
            description,
        )
        metadata[str(role)] = facts | {
            "rig": rig.config.rig,
            "period_ns": str(description["period_ns"]),
        }
        attachments |= description["attachments"]
    return logs.Log(Path(), nodes, attachments, metadata, [], rig=rig.effective())
