"""Fault against detector: injected, noticed, how soon, what followed, the worst pointing error.

Each run begins from the same second of the barrel on its hull, the fault at a drawn cycle with
draws of its own. A row is kept when all that had to notice it did so within the limit, or as often
as the arithmetic says, five standard deviations down.
"""

import math
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from pcpc.executive.rig.reading import load_rig
from pcpc.tools.dev.evidence.campaign import AFTER, SPREAD, WARM, Bench, FaultOutcome
from pcpc.tools.dev.evidence.cases import CASES, RIGS, Case
from pcpc.tools.start.pool import each
from pcpc.tools.study.binomial import lower_bound
from pcpc.tools.terminal.progress import Progress

RIG = Path(__file__).with_name("faults.yaml")  # beside the others
CONTROLLER, CONFIDENCE, AT_ONCE = "pd_nn_fast", 0.95, 250
LONGEST_S = 2.0  # more than any run of the matrix takes
Task = tuple[int, int, int]  # case, first seed, seed past the last


@lru_cache(maxsize=len(RIGS))
def bench(rig: str = "faults") -> Bench:
    """Return this process' rig of that name, warmed up."""
    return Bench(load_rig(RIG.with_stem(rig), CONTROLLER, [f"duration_s={LONGEST_S}"]))


def runs_of(task: Task) -> list[FaultOutcome]:
    """Return what came of some runs of a case."""
    case = CASES[task[0]]
    own = bench(case.rig)
    return [own.run_once(case.faults, case.cycles, seed) for seed in range(task[1], task[2])]


def matrix(runs: int, seed: int, progress: Progress, jobs: int | None = None) -> list[Any]:
    """Return a row a case, of `runs` runs each with the draws from `seed` on."""
    tasks = [
        (number, seed + first, seed + min(first + AT_ONCE, runs))
        for number in range(len(CASES))
        for first in range(0, runs, AT_ONCE)
    ]
    found = each(runs_of, tasks, progress, jobs, lambda task: task[2] - task[1])
    seen: dict[int, list[FaultOutcome]] = {}
    for task, some in zip(tasks, found, strict=True):
        seen.setdefault(task[0], []).extend(some)
    return [row(case, seen[number]) for number, case in enumerate(CASES)]


def row(case: Case, seen: Sequence[FaultOutcome]) -> dict[str, Any]:
    """Return what the runs of a case came to."""
    cycles = sorted(one.noticed for one in seen if one.noticed is not None)
    limit = math.inf if case.limit is None else case.limit
    within = sum(count <= limit for count in cycles)
    wanted = 0 if case.limit is None else least(case.share, len(seen))
    answers, rank = Counter(one.answer for one in seen), ("none", "HOLD", "FAULT")
    worst = max(answers, key=rank.index)
    return {
        "fault": case.name, "cycles": case.cycles, "runs": len(seen), "noticed": len(cycles),
        "limit_cycles": case.limit, "within_limit": within, "wanted": wanted,
        "lower_bound": lower_bound(within, len(seen), CONFIDENCE),
        "p50_cycles": cycles[len(cycles) // 2] if cycles else None,
        "max_cycles": cycles[-1] if cycles else None,
        "by": dict(Counter(one.by for one in seen if one.by)), "answers": dict(answers),
        "faults": dict(Counter(one.fault for one in seen if one.fault)),
        "worst_mrad": 1e3 * max(one.worst_rad for one in seen),
        "kept": within >= wanted and rank.index(worst) <= rank.index(case.answer)
        and (case.limit is not None or not cycles),
        "replay": _replay(case),
    }  # fmt: skip


def least(share: float, runs: int) -> int:
    """Return how many of the runs have to be noticed: all, or the share less 5 deviations."""
    if share >= 1.0:
        return runs
    return math.floor(runs * share - 5.0 * math.sqrt(runs * share * (1.0 - share)))


def _replay(case: Case) -> str:
    """Return the command that shows the row: the same fault once, with its log."""
    words = " ".join(
        f"--set faults.{name}.from={(WARM + SPREAD // 2)}ms --set faults.{name}.for={case.cycles}ms"
        for name in case.faults
    )
    end_s = 1e-3 * (WARM + SPREAD + case.cycles + AFTER)
    rig = f"tools/dev/evidence/{case.rig}.yaml --controller {CONTROLLER}"
    return f"pcpc simulate {rig} --set duration_s={end_s:g} {words}"
