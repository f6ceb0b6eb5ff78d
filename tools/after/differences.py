"""Where two records of a run differ: each variable once, in the order of the loop.

    bits        NaN is NaN, -0.0 is not 0.0
    tolerance   |a - b| <= absolute + relative |a| is equal, too
    order       by time; at one instant by cause: the plant before the executive, and in a node what
                came in, its blocks as they are stepped, limits and signals sent, frames out
    ULP         how many float64 lie between the two values of the first difference

Whatever compares runs does it by these: replay, compare, bisect.
"""

import math
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.tools.after.log.frames import frame_text

Told = TypeVar("Told")  # of a run as a whole
Value = float | int | str  # a str: a frame, or what is there in words
Times = NDArray[np.float64]  # (n,), s
Rows = NDArray[Any]  # frames: (n,) records

SENT = "frames sent"  # all that a node sends, as a name
FRAME, _RECEIVED = "frame ", " received"  # how the name of those of one id begins, and ends
_KINDS = ("parameter", "input", "state", "output")
_CLAMPED = "supervisor.saturated"  # the only one of the supervisor's that the limits set
_STAGES = {"<in": "frames in", "rx": "frames in", "tx": "limits, sent", "<out": "frames out"}


class Tolerance(NamedTuple):
    """How far two numbers may lie apart; 0 and 0: every bit counts."""

    relative: float = 0.0
    absolute: float = 0.0


EXACT = Tolerance()


class Difference(msgspec.Struct):
    """Of a variable, or of frames: where it begins, how often, how large it becomes.

    `largest` is None for what has no size: a frame, a NaN; `is_endless`: an infinite one, too.
    `place`, `stage`: when a cycle comes to it.
    """

    node: str
    name: str  # in its node
    cycle: int
    time_s: float
    here: Value
    there: Value
    ulp: int | None = None  # None: a frame, a NaN
    count: int = 0
    largest: float | None = None
    largest_time_s: float | None = None
    is_endless: bool = False
    place: tuple[int, int] = (0, 0)
    stage: str = ""

    @property
    def is_frame(self) -> bool:
        """Frames differ, and no variable."""
        return self.name.startswith(FRAME)

    @property
    def label(self) -> str:
        """The name among those of all nodes."""
        if self.node == "executive":
            return self.name
        frame = FRAME * self.is_frame
        return f"{frame}{self.node}.{self.name.removeprefix(frame)}"

    @property
    def texts(self) -> tuple[str, str]:
        """Both values, with as many digits as they need to come back."""
        here, there = (x if isinstance(x, str) else repr(x) for x in (self.here, self.there))
        return here, there


@dataclass(frozen=True)
class Change(Generic[Told]):
    """A value of two runs as a whole, old and new; null for one that only the other side has."""

    name: str
    old: Told
    new: Told

    @property
    def differs(self) -> bool:
        """It is not the same on both sides; NaN is NaN."""
        return bool(self.old != self.new and not are_nan(self.old, self.new))

    @property
    def relative(self) -> float:
        """How much larger the new value is, as a share of the old one; NaN if that says nothing."""
        old: Any = self.old
        new: Any = self.new
        if not all(isinstance(v, int | float) for v in (old, new)) or not old:
            return math.nan
        return float((new - old) / abs(old))


def loop_order(one: Difference) -> tuple[float, int, int, tuple[int, int]]:
    """Return what sorts differences by time and, at one instant, by cause before effect."""
    node = logs.NODES.index(one.node) if one.node in logs.NODES else 0  # a device: the executive
    return one.time_s, one.cycle, -node, one.place


class CycleOrder:
    """The order in which a cycle of a node comes to frames and variables."""

    def __init__(self, variables: Iterable[Sequence[str]]) -> None:
        """`variables`: rows of the node's description; name, unit, kind, writer first."""
        rows = list(variables)
        self._kinds = {row[0]: row[2] for row in rows}
        blocks = [row[3] for row in rows if row[2] in _KINDS and row[3] != "loop"]
        self._blocks = list(dict.fromkeys(blocks))
        self._keys = ["<in", "rx", "", *self._blocks, "tx", "<out"]

    def place(self, name: str) -> tuple[int, int]:
        """Return what sorts those of one cycle; without an order of their own they keep theirs."""
        key, kind = _stage_key(name), self._kinds.get(name, "")
        at = self._keys.index(key if key in self._keys else "")
        return at, _KINDS.index(kind) if kind in _KINDS else 0

    def stage(self, name: str) -> str:
        """Return in words when a cycle comes to it."""
        key = _stage_key(name)
        return f"block {key}" if key in self._blocks else _STAGES.get(key, key)


def _stage_key(name: str) -> str:
    if name.startswith((FRAME, SENT)):
        return "<in" if name.endswith(_RECEIVED) else "<out"
    return "tx" if name == _CLAMPED else name.partition(".")[0]


class Differences(dict[str, Difference]):
    """What differs between two records of a node, by name; found piece by piece."""

    def __init__(
        self,
        node: str,
        variables: Iterable[Sequence[str]] = (),
        tolerance: Tolerance = EXACT,
    ) -> None:
        """`variables`: as of `CycleOrder`."""
        super().__init__()
        self._node, self._order, self.tolerance = node, CycleOrder(variables), tolerance

    def ordered(self) -> list[Difference]:
        """Return them in the order of the loop."""
        return sorted(self.values(), key=loop_order)

    def note(
        self, name: str, cycle: int, time_s: float, here: Value, there: Value, count: int = 1
    ) -> Difference:
        """Return the difference of this name, which begins here if it has not begun before."""
        if name not in self:
            numbers = isinstance(here, float) and isinstance(there, float)
            ulp = ulp_distance(float(here), float(there)) if numbers else None
            place, stage = self._order.place(name), self._order.stage(name)
            self[name] = Difference(
                self._node, name, cycle, time_s, here, there, ulp, place=place, stage=stage
            )
        self[name].count += count
        return self[name]

    def add(
        self, name: str, cycle: NDArray[np.int64], time_s: Times, here: Times, there: Times
    ) -> None:
        """Compare a variable in the cycles that both have; all (n,)."""
        at = np.flatnonzero(unequal(here, there, self.tolerance))
        if not len(at):
            return
        a, b, first = here[at], there[at], int(at[0])
        first_s = float(time_s[first])
        found = self.note(name, int(cycle[first]), first_s, float(a[0]), float(b[0]), len(at))
        with np.errstate(invalid="ignore", over="ignore"):
            distance = np.abs(a - b)
        found.is_endless |= bool(np.isinf(distance).any())
        sized = np.flatnonzero(np.isfinite(distance))
        if len(sized):
            row = int(sized[np.argmax(distance[sized])])
            if found.largest is None or distance[row] > found.largest:
                found.largest, found.largest_time_s = float(distance[row]), float(time_s[at[row]])

    def add_frames(
        self,
        name: str,
        here: Rows,
        there: Rows,
        fields: Sequence[str],
        times_s: Sequence[Times],
        text: Callable[[Any], str] = frame_text,
    ) -> None:
        """Compare frames one by one in these fields; `times_s`: of both, (n,) each."""
        count, at = unequal_frames(here, there, fields)
        if count:
            longer, time_s = (here, times_s[0]) if len(here) > at else (there, times_s[1])
            texts = unequal_texts(here, there, at, text)
            self.note(name, int(longer["cycle"][at]), float(time_s[at]), *texts, count)


def are_nan(*values: Any) -> bool:
    """Return whether values are NaN, all of them."""
    return all(isinstance(one, float) and math.isnan(one) for one in values)


def unequal(here: Times, there: Times, tolerance: Tolerance = EXACT) -> NDArray[np.bool_]:
    """Return where numbers differ; all (n,)."""
    same = here.view(np.int64) == there.view(np.int64)
    if same.all():
        return ~same
    same |= np.isnan(here) & np.isnan(there)
    if any(tolerance):
        with np.errstate(invalid="ignore", over="ignore"):
            distance = np.abs(here - there)
            near = distance <= tolerance.absolute + tolerance.relative * np.abs(here)
            same |= near & np.isfinite(distance)
    return ~same


def unequal_frames(a: Rows, b: Rows, fields: Sequence[str]) -> tuple[int, int]:
    """Return how many frames differ in these fields or have no counterpart, and where the first."""
    n = min(len(a), len(b))
    differs = np.zeros(n, bool)
    for field_ in fields:
        other = a[field_][:n] != b[field_][:n]
        differs |= other.any(axis=1) if other.ndim > 1 else other
    count = int(differs.sum()) + abs(len(a) - len(b))
    return count, int(differs.argmax()) if differs.any() else n


def unequal_texts(
    a: Rows, b: Rows, at: int, text: Callable[[Any], str] = frame_text
) -> tuple[str, str]:
    """Return two recorded frames that differ, "none" for none, so that one sees in what."""
    texts = ["none" if at >= len(frames) else text(frames[at]) for frames in (a, b)]
    if texts[0] == texts[1]:
        texts = [
            f"{frame_text(one)}, behind it {bytes(one['data'][int(one['dlc']) :]).hex().upper()}, "
            f"cycle {int(one['cycle'])}, check {int(one['e2e'])}"
            for one in (a[at], b[at])
        ]
    return texts[0], texts[1]


def ulp_distance(a: float, b: float) -> int | None:
    """Return how many float64 lie between two numbers; None if one is NaN."""
    if math.isnan(a) or math.isnan(b):
        return None
    bits = struct.unpack("<2q", struct.pack("<2d", a, b))
    first, second = (x if x >= 0 else -(1 << 63) - x for x in bits)
    return abs(first - second)
