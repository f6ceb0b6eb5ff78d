"""What speaks for or against a run, one by one: limits, requirements, loss, faults, damage.

Every judge yields `Finding`s; the keys of a summary, a suite, JUnit and the pytest plugin are made
of them. `LINES` says which key of summary.json lists a kind that does not hold, and `GRAVITY` which
verdict it costs. A summary that was read back has no findings: a log is judged for them.
"""

import math
from collections.abc import Iterable
from enum import StrEnum

import msgspec

NOT_JUDGED = "not judged"
GRAVITY = "ok", NOT_JUDGED, "expectation not met", "loss", "safety stop", "interrupted"


class FindingKind(StrEnum):
    """What a finding is about."""

    LIMIT = "limit"  # of a metric
    REQUIREMENT = "requirement"  # in time
    TIMING = "timing"  # of the loop, by the rig's `timing`
    EVALUATION = "evaluation"  # it failed, or its figure did
    DEVICE = "device"  # it sent what it should not
    MASTER = "master"  # of a drive, which made a mistake
    END = "end"  # somebody else ended the run
    STRICT = "strict"  # of --judge, which takes what was not judged for not met
    INPUT = "input"  # nothing took it on purpose, or a row found no place in a ring
    FRAMES = "frames"  # more wrong ones than the rig allows
    LOG = "log"  # a part of it, or a file beside it, is missing
    SUMMARY = "summary"  # what lies beside the log is not of it
    FAULT = "fault"  # of a node
    STOP = "stop"  # Ctrl-C


_UNMET = "expectations_failed", "expectation not met"
LINES = dict.fromkeys(FindingKind, _UNMET) | {  # key of summary.json, verdict
    FindingKind.INPUT: ("lost", "loss"),
    FindingKind.FRAMES: ("frames_too_many", "loss"),
    FindingKind.LOG: ("log_missing", "loss"),
    FindingKind.FAULT: ("faults", "safety stop"),
    FindingKind.STOP: ("", "interrupted"),  # the summary says when
}
JUDGED = FindingKind.LIMIT, FindingKind.REQUIREMENT, FindingKind.TIMING  # kinds that may hold
OF_THE_RIG = FindingKind.LIMIT, FindingKind.REQUIREMENT  # kinds without which nothing was judged


class Finding(msgspec.Struct, frozen=True):
    """One thing that speaks for or against a run.

    held       True, False, or None: not judged, `why` says why not
    why        in words, without the name
    low, high  what `value` has to lie between, in `unit`
    margin     how far it was from not being held, negative: it was not
    first_...  where it was first not held
    """

    kind: FindingKind
    why: str = ""
    held: bool | None = False
    name: str = ""
    id: str = ""
    value: float | None = None
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    margin: float | None = None
    first_cycle: int | None = None
    first_s: float | None = None

    @property
    def named(self) -> str:
        """Its name behind its id, if it has one."""
        return f"{self.id} {self.name}" if self.id else self.name

    @property
    def key(self) -> str:
        """What `judged` and `not_judged` of summary.json call it: a limit has no id there."""
        return self.name if self.kind is FindingKind.LIMIT else self.named or str(self.kind)

    def __str__(self) -> str:
        """Return the line of words that says it."""
        if self.held is None:
            return f"{self.named} was not judged: {self.why}"
        between = ": " if self.kind is FindingKind.REQUIREMENT else " " if self.name else ""
        return f"{self.named}{between}{self.why}"


def lines(kind: FindingKind, words: Iterable[str]) -> list[Finding]:
    """Return a finding for each line of words against a run."""
    return [Finding(kind, line) for line in words]


def verdict_of(findings: Iterable[Finding], verdict: str = "ok") -> str:
    """Return the gravest of a `verdict` and those of what does not hold."""
    words = [LINES[one.kind][1] for one in findings if one.held is False]
    return max([verdict, *words], key=lambda word: word in GRAVITY and GRAVITY.index(word))
