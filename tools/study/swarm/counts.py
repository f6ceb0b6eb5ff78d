"""Counts: of frames that did not come, drawn at the rig's limits; of cycles between slow frames.

On a drawn rig's bus no frame is repeated; a judge may forget those all the same.
"""

import copy
import dataclasses
import random
from collections.abc import Iterator

import numpy as np

from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.after.verdict.summary import Summary, summarise
from pcpc.tools.study.swarm.case import Case
from pcpc.tools.study.swarm.files import frames_of

_LIMITS = {  # of the rig's errors, by what is counted
    "crc_errors": "crc", "repeated": "repeated", "wrong_sequence": "wrong_sequence",
    "implausible": "implausible", "send_errors": "send", "bus_errors": "bus",
}  # fmt: skip
_STATES = {"repeated": "2", "wrong_sequence": "3", "crc_errors": "4"}  # as the recorder counts
_MILDER = "ok", "not judged", "expectation not met"


def judged(case: Case) -> Iterator[str]:
    """Yield where one count more or less is not judged as the rig says."""
    draw = random.Random(case.world["at"]["sample"])
    name, key = draw.choice([*_LIMITS.items()])
    role, most = draw.choice([*case.log.node]), getattr(case.rig.config.errors, key)
    before, there = case.summary.verdict, case.summary.frames[name]
    for count, milder in ((most, before), (most + 1, "loss")):
        told = _told(case, role, name, count - there).verdict
        wanted = milder if before in _MILDER else before
        if there <= most and told != wanted:
            yield f"{count} {name}, of which {most} are allowed: {told}, not {wanted}"
    yield from _account(case, role, draw.choice([*_STATES]))


def paced(case: Case) -> Iterator[str]:
    """Yield slow frames that their node sent sooner or later than the rig says."""
    still = any(one.kind == "stall" for one in case.rig.config.faults.values())
    for name, word, frame, role, _ in () if still else frames_of(case.world):
        rows = case.log.node[role].frames
        sent = rows["cycle"][(rows["id"] == word) & (rows["direction"] == 0)]
        every = max(1, round(1e-3 * frame.get("ms", 0) * case.world["rate_hz"]))
        if (np.diff(sent)[:-1] != every).any():
            yield f"{role}: {name} came in cycles {sent.tolist()[:4]}, not each {every}"


def _told(case: Case, role: str, name: str, more: int) -> Summary:
    outcome = copy.deepcopy(case.outcome)
    outcome.health[role][name] += more
    return summarise(case.rig, case.log, outcome, Judge.of(case.rig))


def _account(case: Case, role: str, name: str) -> Iterator[str]:
    """Yield where a frame that was used is not accounted for as another, if it is one."""
    counts = dict(case.log.metadata.get("frames", {}))
    used = [key for key in counts if key.startswith(f"{role}.received.") and key.endswith(".0")]
    if not used or role not in case.summary.frames_to:
        return
    other = f"{used[0][:-1]}{_STATES[name]}"
    counts[used[0]] = str(int(counts[used[0]]) - 1)
    counts[other] = str(int(counts.get(other, "0")) + 1)
    log = dataclasses.replace(case.log, metadata=case.log.metadata | {"frames": counts})
    true = case.summary.frames_to[role]
    told = summarise(case.rig, log, case.outcome, Judge.of(case.rig)).frames_to[role]
    if told != true | {"used": true["used"] - 1, name: true[name] + 1}:
        yield f"{role}: one {name} more and one used less: {told}, not {true}"
