"""False alarms: hours without a fault, in which nothing may be held, refused or stopped.

Runs of several rigs in lanes: the barrel on its hull, each with another seed of all noise; plants
without noise, each with another mass. Counters and states of both nodes are looked at, at their end
and at their highest.
"""

import math
import random
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcpc.drivers.compiled.lanes import WIDTH
from pcpc.executive.batch.runs import BatchRuns, Case, RunResult
from pcpc.tools.start import rigs
from pcpc.tools.start.pool import each
from pcpc.tools.terminal.progress import Progress

RUN_S, CONFIDENCE = 60.0, 0.95
COUNTERS = ("health.held_cycles", "health.stale_cycles", "health.frames_lost", "supervisor.fault")
NODES = ("executive", "plant")


class Clean(NamedTuple):
    """A rig, how many of ten hours are its own, and the setting that is drawn within 10 %."""

    name: str
    controller: str
    tenths: int
    setting: str = ""


RIGS = (
    Clean("hull", "pd_nn_fast", 4),
    Clean("backlash-pendulum", "nn", 2, "pendulum.mass_kg"),
    Clean("deadzone-sine", "nn", 2, "arm.m1_kg"),
    Clean("friction-c", "nn_standard", 2, "arm.m1_kg"),
)
Task = tuple[int, int]  # rig, first seed


@lru_cache
def _runs(rig: int) -> BatchRuns:
    wanted: dict[Any, list[str]] = {role: [*COUNTERS] for role in NODES}
    name, controller = RIGS[rig][:2]
    return BatchRuns(Path(rigs.find(name)), controller, [f"duration_s={RUN_S}"], wanted)


def case(rig: int, seed: int) -> Case:
    """Return a run of a rig."""
    if not (name := RIGS[rig].setting):
        return Case(seed)
    block, _, setting = name.partition(".")
    specs = (spec for spec in _runs(rig).rig.nodes()["plant"].blocks if spec.name == block)
    value = float(next(specs).settings[setting])
    return Case(seed, {name: value * random.Random(f"{name}/{seed}").uniform(0.9, 1.1)})


def group(task: Task) -> dict[str, int]:
    """Return the alarms of WIDTH runs of a rig, with the seeds from the first on."""
    rig, first = task
    return alarm_counts(_runs(rig).done([case(rig, first + i) for i in range(WIDTH)]))


def alarm_counts(runs: Sequence[RunResult]) -> dict[str, int]:
    """Return the alarms of runs, by kind."""
    total = dict.fromkeys((*COUNTERS, "ended early"), 0)
    for done in runs:
        total["ended early"] += done.log is None or bool(done.fault)
        if done.log is None:
            continue
        for node in NODES:
            log = done.log.node[node]
            for counter in COUNTERS:
                values = log.timing[counter] if counter in log.timing else log.columns[counter]
                total[counter] += int(np.max(values))
    return total


def alarms(hours: float, seed: int, progress: Progress, jobs: int | None) -> Mapping[str, Any]:
    """Return the alarms in so many hours, and the rate that they stay below with 95 %."""
    group_h = WIDTH * RUN_S / 3600.0
    counts = [math.ceil(hours * one.tenths / (10.0 * group_h)) for one in RIGS]
    tasks = [(rig, seed + WIDTH * i) for rig, n in enumerate(counts) for i in range(n)]
    found = each(group, tasks, progress, jobs, lambda task: WIDTH)
    rows: list[dict[str, Any]] = []
    for number, (one, n) in enumerate(zip(RIGS, counts, strict=True)):
        some = [some for (rig, _), some in zip(tasks, found, strict=True) if rig == number]
        total = {counter: sum(one[counter] for one in some) for counter in found[0]}
        rows.append({"rig": one.name, "controller": one.controller, "drawn": one.setting or "noise",
                     "hours": n * group_h, "runs": WIDTH * n, "alarms": total})  # fmt: skip
    spent_h, count = len(tasks) * group_h, sum(sum(row["alarms"].values()) for row in rows)
    upper = None if count else -math.log(1.0 - CONFIDENCE) / spent_h
    return {"hours": spent_h, "runs": WIDTH * len(tasks), "run_s": RUN_S, "rigs": rows,
            "upper_bound_per_h": upper, "kept": count == 0}  # fmt: skip
