"""The log of a plant alone, as what judges runs wants it: with a record of the executive.

That record has the plant's cycles and their timing and, of what a rig's executive tells, what no
device can change: the blocks without inputs, references that is. Everything else in it is NaN, and
what asks for it is not judged.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.plan import cycles_of, describe, plan
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.requirements import text_of, timed_requirement
from pcpc.tools.after.verdict.findings import Finding, FindingKind
from pcpc.tools.after.verdict.judge import EvaluationError, Judge
from pcpc.tools.after.verdict.requirements import SignalNames

WHY = "it needs variables that only an executive of pcpc records"
Vector = NDArray[np.float64]


def run_of_device(rig: Rig, log: logs.Log, pacing: str) -> logs.Log:
    """Return `log`, of a plant, with the record of an executive; RigError, BusError as `plan`."""
    lead = rig.config.below[0]
    plant = log.node[lead]
    kept = plant.cycle < cycles_of(rig)
    about = describe(plan(rig, "executive", pacing), {})
    cycle, nothing = plant.cycle[kept], np.full(int(kept.sum()), math.nan)
    columns = dict.fromkeys(about["state_columns"], nothing)
    if "time.t_s" in columns:
        columns["time.t_s"] = cycle * 1e-9 * about["period_ns"]
    columns |= _references(rig, about, cycle)
    timing = {k: v[kept] for k, v in plant.timing.items() if k.startswith("timing.")}
    bare = logs.NodeLog(
        cycle, plant.stamp_ns[kept], columns, timing, np.empty(0, logs.FRAME), [], [], about
    )
    metadata = {**log.metadata, "executive": log.metadata[lead]}
    return replace(log, node={"executive": bare, **log.node}, metadata=metadata)


def _references(rig: Rig, about: Mapping[str, Any], cycle: NDArray[np.int64]) -> dict[str, Vector]:
    """Return what blocks without inputs told in these cycles, from a run in virtual time."""
    from pcpc.executive.nodes.virtual import in_memory  # here, because it compiles

    spec = rig.nodes()["executive"]
    own = tuple(f"{block.name}." for block in spec.blocks if not block.inputs)
    names = [name for name in about["state_columns"] if name.startswith(own)] if own else []
    if not names or not len(cycle):
        return {}
    known = in_memory(rig).node["executive"]
    row = np.clip(cycle, 0, len(known.cycle) - 1)
    return {name: np.asarray(known.columns[name])[row] for name in names}


def judge_of_device(judge: Judge, log: logs.Log) -> tuple[Judge, list[Finding]]:
    """Return a judge of what the log of a plant tells, and what of the rest is not judged."""
    config, left = judge.rig.config, dict[str, str]()
    expected = config.expected
    try:
        metrics = judge.metrics(log)
        left = {name: WHY for name in expected if math.isnan(metrics.get(name, math.nan))}
    except EvaluationError as error:
        left = dict.fromkeys(expected, str(error))
    known = SignalNames(log, judge.evaluation.signals)
    require = list(judge.required().values())
    silent = [entry for entry in require if _asks_for_more(judge, log, known, entry)]
    rig = judge.rig.changed(
        expect={config.controller: {k: v for k, v in expected.items() if k not in left}},
        require=[entry for entry in require if entry not in silent],
    )
    unjudged = [Finding(FindingKind.LIMIT, why, None, name) for name, why in left.items()]
    unjudged += [Finding(FindingKind.REQUIREMENT, WHY, None, text_of(entry)) for entry in silent]
    return replace(judge, rig=rig), unjudged


def _asks_for_more(judge: Judge, log: logs.Log, known: SignalNames, entry: Any) -> bool:
    """Return whether a requirement asks for a value that no cycle of the log has."""
    run = judge.judged(log).run()
    for name in timed_requirement(entry, known.unit).names:
        node, variable = known.place(name)
        values = run.get(f"{node}:{variable}" if node else name)
        if not np.isfinite(values).any():
            return True
    return False
