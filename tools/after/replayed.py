"""What came of a replay: by node, what was compared and where it differs."""

from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from pcpc.drivers.errors import Exit
from pcpc.tools.after.log.cat import unequal_frames, unequal_texts
from pcpc.tools.after.log.ulp import ulp_distance
from pcpc.tools.terminal import screen

SENT = "frames sent"
_ROWS_SHOWN = 20


@dataclass
class Difference:
    """Of one variable, or of the frames sent: where it began, how often, how large it became."""

    name: str
    cycle: int
    recorded: str
    recomputed: str
    ulp: int | None  # of a frame or a NaN none
    count: int = 0
    largest: float = 0.0


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
    differences: dict[str, Difference] = field(default_factory=dict)

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

    def note(self, name: str, cycle: int, old: Any, new: Any) -> Difference:
        """Return the difference of a variable, which begins here if it has not begun before."""
        both = isinstance(old, float) and isinstance(new, float)
        ulp = ulp_distance(old, new) if both else None
        first = Difference(name, cycle, repr(old), repr(new), ulp)
        return self.differences.setdefault(name, first)

    def ordered(self) -> list[Difference]:
        """Return the differences, earliest first, in one cycle in the order of its stages."""

        def stage(d: Difference) -> tuple[int, bool, bool]:
            return d.cycle, d.name == SENT, d.name.startswith("tx.")

        return sorted(self.differences.values(), key=stage)

    def first(self) -> Difference | None:
        """Return the earliest difference."""
        return next(iter(self.ordered()), None)


def compare_frames(verdict: Verdict, recorded: NDArray[Any], computed: NDArray[Any]) -> None:
    """Note the first frame that differs; `count` counts all. Both (n,) records."""
    count, at = unequal_frames(recorded, computed, ("cycle", "id", "dlc", "data"))
    verdict.frames += min(len(recorded), len(computed))
    if not count:
        return
    old, new = unequal_texts(recorded, computed, at)
    longer = recorded if len(recorded) > at else computed
    first = Difference(SENT, int(longer["cycle"][at]), old, new, None)
    verdict.differences.setdefault(SENT, first).count += count


def plain(verdict: Verdict) -> dict[str, Any]:
    """Return a verdict for JSON."""
    first = verdict.first()
    return {
        "node": verdict.role, "identical": verdict.identical, "cycles": verdict.cycles,
        "planned": max(verdict.planned, verdict.cycles),
        "variables": verdict.variables, "frames": verdict.frames,
        "keyframes": verdict.keyframes, "speed": verdict.speed,
        "incomplete": verdict.incomplete, "missing": verdict.missing,
        "from_record": verdict.from_record,
        "first": None if first is None else vars(first),
        "differences": [vars(d) for d in verdict.ordered()],
    }  # fmt: skip


def report(verdict: Verdict, changed: bool) -> list[str]:
    """Return one node's verdict as lines: the first, and what differs."""
    size = f"{verdict.extent}, {verdict.variables} variables, {verdict.frames} frames"
    state = verdict.state
    if changed and verdict.anything:
        state = "changed, in open loop" if verdict.differences else "no difference"
    told = screen.wrapped_lines(
        f"{size}: {state} ({verdict.speed:.0f} x real time)", f"{verdict.role:10} "
    )
    for line in (*verdict.from_record, *verdict.missing, verdict.incomplete):
        if line:
            told += screen.wrapped_lines(line, "  ")
    first = verdict.first()
    if first is None:
        return told
    told += screen.wrapped_lines(
        f"first difference: cycle {first.cycle} ({first.cycle / verdict.rate_hz:.6g} s), "
        f"{first.name}: recorded {first.recorded}, recomputed {first.recomputed}"
        + ("" if first.ulp is None else f", {first.ulp} ULP"),
        "  ",
    )
    rows = [("    variable", "cycle", "cycles", "largest", "first recorded, recomputed")]
    for d in verdict.ordered()[:_ROWS_SHOWN]:
        largest = f"{d.largest:.3g}" if d.largest else "-"
        values = f"{d.recorded}, {d.recomputed}"
        rows.append((f"    {d.name}", str(d.cycle), str(d.count), largest, values))
    told += screen.table(rows, right=(1, 2, 3))
    if len(verdict.differences) > _ROWS_SHOWN:
        told.append(f"  and {len(verdict.differences) - _ROWS_SHOWN} more; --json prints all")
    return told
