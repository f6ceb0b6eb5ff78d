"""False alarms: hours without a fault, in which nothing may be held, refused or stopped.

Runs of the barrel on its hull in lanes, each with another seed of all noise; counters and states of
both nodes are looked at, at their end and at their highest.
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.drivers.lanes import WIDTH
from pcpc.executive.batch.runs import Case, Runs
from pcpc.tools.console.progress import Progress
from pcpc.tools.starting.pool import each

RIG = Path(__file__).resolve().parents[2] / "plants/atb1000/rigs/hull.yaml"
CONTROLLER, RUN_S, CONFIDENCE = "pd_nn_fast", 12.0, 0.95
COUNTERS = ("health.held_cycles", "health.stale_cycles", "health.frames_lost", "supervisor.fault")
NODES = ("executive", "plant")


@lru_cache(maxsize=1)
def _runs() -> Runs:
    wanted: dict[Any, list[str]] = {role: [*COUNTERS] for role in NODES}
    return Runs(RIG, CONTROLLER, [f"duration_s={RUN_S}"], wanted)


def group(first: int) -> dict[str, int]:
    """Return the alarms of WIDTH runs with the seeds from `first` on."""
    total = dict.fromkeys((*COUNTERS, "ended early"), 0)
    for done in _runs().done([Case(first + i) for i in range(WIDTH)]):
        total["ended early"] += done.log is None or bool(done.fault)
        if done.log is None:
            continue
        for node in NODES:
            log = done.log.node[node]
            for name in COUNTERS:
                values = log.timing[name] if name in log.timing else log.columns[name]
                total[name] += int(np.max(values))
    return total


def alarms(hours: float, seed: int, progress: Progress, jobs: int | None) -> Mapping[str, Any]:
    """Return the alarms in so many hours, and the rate that they stay below with 95 %."""
    groups = math.ceil(hours * 3600.0 / (WIDTH * RUN_S))
    firsts = [seed + WIDTH * i for i in range(groups)]
    found = each(group, firsts, progress, jobs, lambda first: WIDTH)
    total = {name: sum(one[name] for one in found) for name in found[0]}
    spent_h = groups * WIDTH * RUN_S / 3600.0
    count = sum(total.values())
    upper = None if count else -math.log(1.0 - CONFIDENCE) / spent_h
    return {"hours": spent_h, "runs": groups * WIDTH, "alarms": total,
            "upper_bound_per_h": upper, "kept": count == 0}  # fmt: skip
