"""What came of a replay: by node, what was compared and where it differs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

from msgspec import Meta, Struct

from pcpc.drivers.errors import Exit
from pcpc.tools.after.differences import SENT, Difference, Differences, Rows
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.answer import AnyNode, Count, Number, Positive

_ROWS_SHOWN = 20


@dataclass
class Verdict:
    """What came of one node."""

    role: str
    rate_hz: float
    cycles: int = 0
    planned: int = 0  # cycles of the whole run
    variables: int = 0
    frames: int = 0
    keyframes: int = 0
    spent_s: float = 0.0
    incomplete: str = ""  # why not all could be recomputed
    dropped: int = 0  # frames and events that the recorder has not got
    missing: list[str] = field(default_factory=list)  # damage of the log
    from_record: list[str] = field(default_factory=list)  # what was not recomputed
    described: Sequence[Sequence[str]] = ()  # its variables, as in its description
    differences: Differences = field(init=False)

    def __post_init__(self) -> None:
        """Begin without a difference."""
        self.differences = Differences(self.role, self.described)

    @property
    def identical(self) -> bool:
        """All that was recorded is recomputed, bit for bit, and the log is whole."""
        return self.agrees and not self.missing

    @property
    def agrees(self) -> bool:
        """All that was to be compared is recomputed, bit for bit, and that is not nothing."""
        return not (self.differences or self.incomplete) and self.anything

    @property
    def anything(self) -> bool:
        """Something was compared at all."""
        return bool(self.cycles and (self.variables or self.frames))

    @property
    def extent(self) -> str:
        """How many cycles of how many were recomputed."""
        return f"{self.cycles} of {max(self.planned, self.cycles)} cycles"

    @property
    def code(self) -> Exit:
        """The exit code: what differs goes before what is missing."""
        if self.differences:
            return Exit.NOT_MET
        return Exit.OK if self.identical else Exit.LOSS

    @property
    def state(self) -> str:
        """What came of it, in words."""
        if self.identical:
            return "bit-identical"
        if self.differences:
            return "DIFFERENT, in an incomplete log" if self.missing else "DIFFERENT"
        return "bit-identical as far as the log goes" if self.anything else "nothing to compare"

    @property
    def speed(self) -> float:
        """Recomputed time over time spent."""
        return self.cycles / self.rate_hz / max(self.spent_s, 1e-9)

    def first(self) -> Difference | None:
        """Return the earliest difference."""
        return next(iter(self.differences.ordered()), None)


def compare_frames(verdict: Verdict, recorded: Rows, computed: Rows) -> None:
    """Note the first frame that differs; `count` counts all."""
    verdict.frames += min(len(recorded), len(computed))
    times_s = [frames["cycle"] / verdict.rate_hz for frames in (recorded, computed)]
    fields = "cycle", "id", "dlc", "data"
    verdict.differences.add_frames(SENT, recorded, computed, fields, times_s)


class ReplayedDifference(Struct):
    """Of a variable, or of the frames of a node."""

    name: str
    "a variable, or: frames sent, end of the node"
    cycle: int
    "of the first one"
    recorded: str
    "there, as Python writes it; of frames the first one"
    recomputed: str
    "there"
    ulp: int | None
    "of the first one, in units of the last place; null: of frames, or NaN"
    count: Positive
    "cycles, or frames, that differ"
    largest: Number
    "absolute, in the unit of the variable; of frames 0"


class ReplayedNode(Struct):
    """What was recomputed of a node."""

    node: AnyNode
    identical: bool
    "all of a whole log, bit for bit"
    cycles: Count
    "that were recomputed"
    planned: Count
    "cycles of the whole run"
    variables: Count
    "that were compared"
    frames: Count
    "that were compared"
    keyframes: Count
    "that were compared with the state that was recomputed"
    speed: float
    "recomputed time over time spent"
    incomplete: str
    "why not all could be recomputed; empty: all was"
    missing: list[str]
    "damage of the log, in words"
    from_record: list[str]
    "what was taken from the log, in words"
    first: ReplayedDifference | None
    "null: nothing differs"
    differences: list[ReplayedDifference]
    "the earliest first"


ReplayedNodes = Annotated[list[ReplayedNode], Meta(min_length=1)]


def plain(verdict: Verdict) -> ReplayedNode:
    """Return a verdict for JSON."""
    differences = [_plain(one) for one in verdict.differences.ordered()]
    return ReplayedNode(
        node=verdict.role, identical=verdict.identical, cycles=verdict.cycles,
        planned=max(verdict.planned, verdict.cycles), variables=verdict.variables,
        frames=verdict.frames, keyframes=verdict.keyframes, speed=verdict.speed,
        incomplete=verdict.incomplete, missing=verdict.missing,
        from_record=verdict.from_record, first=next(iter(differences), None),
        differences=differences,
    )  # fmt: skip


def _plain(one: Difference) -> ReplayedDifference:
    here, there = one.texts
    sizes = one.ulp, one.count, _largest(one)
    return ReplayedDifference(one.name, one.cycle, here, there, *sizes)


def _largest(one: Difference) -> float:
    return math.inf if one.is_endless else one.largest or 0.0


def report(verdict: Verdict, changed: bool) -> list[str]:
    """Return one node's verdict as lines: the first, and what differs."""
    size = f"{verdict.extent}, {verdict.variables} variables, {verdict.frames} frames"
    state = verdict.state
    if changed and verdict.anything:
        state = "changed, in open loop" if verdict.differences else "no difference"
    told = [f"{verdict.role:10} {size}: {state} ({verdict.speed:.0f} x real time)"]
    known = (*verdict.from_record, *verdict.missing, verdict.incomplete)
    told += [f"  {line}" for line in known if line]
    first = verdict.first()
    if first is None:
        return told
    recorded, recomputed = first.texts
    told.append(
        f"  first difference: cycle {first.cycle} ({first.cycle / verdict.rate_hz:.6g} s), "
        f"{first.name}: recorded {recorded}, recomputed {recomputed}"
        + ("" if first.ulp is None else f", {first.ulp} ULP")
    )
    rows = [("    variable", "cycle", "cycles", "largest", "first recorded, recomputed")]
    for d in verdict.differences.ordered()[:_ROWS_SHOWN]:
        largest = f"{most:.3g}" if (most := _largest(d)) else "-"
        rows.append((f"    {d.name}", str(d.cycle), str(d.count), largest, ", ".join(d.texts)))
    told += screen.table(rows, right=(1, 2, 3))
    if len(verdict.differences) > _ROWS_SHOWN:
        told.append(f"  and {len(verdict.differences) - _ROWS_SHOWN} more; --json prints all")
    return told
