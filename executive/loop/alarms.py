"""Alarms while a node runs: what its counters say went wrong since they were last looked at.

    late    cycles that woke later than the rig's `alarms.late_us` (one period); known to 1/8
    others  a counter that rose by more than the rig allows in a second

At most one alarm a second of each kind, with how often it happened meanwhile. Only clients count
here: the loop does nothing for it. Without a clock nothing is an alarm.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.buckets import OF_STAGES, place_of
from pcpc.executive.loop.timing_layout import Stage

EVERY_S = 1.0
KINDS = {  # a key of the rig's `alarms` but for its end; word of `control`, what it counts
    "lost": ("lost", "frame lost"),
    "crc": ("crc_errors", "frame with a wrong CRC or length"),
    "held": ("held", "cycle on a held input"),
    "skipped": ("skipped", "period skipped"),
    "send": ("send_errors", "frame that the bus did not take"),
    "bus": ("bus_errors", "error reported by the CAN controller"),
}


@dataclass(frozen=True)
class Alarm:
    """What happened how often up to a cycle of a node."""

    node: str
    kind: str
    cycle: int
    t_s: float
    count: int
    what: str

    def __str__(self) -> str:
        where = f"{self.t_s:.3f} s cycle {self.cycle}"
        return f"{where}: alarm: {self.node}: {self.count} x {self.what}"


class Alarms:
    """The alarms of one node, of which `block` is the memory."""

    def __init__(self, block: sh.NodeMemory) -> None:
        description = block.description
        self._block, self._node = block, str(description["node"])
        self._period_ns = int(description["period_ns"])
        self._limits = description.get("alarms", {})
        late_us = self._limits.get("late_us") or 1e-3 * self._period_ns
        self._past = place_of(round(1e3 * late_us), *OF_STAGES) + 1
        self._late = f"cycle later than {late_us:.6g} us"
        self._told = dict.fromkeys(("late", *KINDS), 0)
        self._quiet_s, self._second_s = (dict.fromkeys(self._told, 0.0) for _ in range(2))

    def look(self, now_s: float | None = None) -> Iterator[Alarm]:
        """Yield what is an alarm now; `now_s` is monotonic."""
        control, now_s = self._block.control, time.monotonic() if now_s is None else now_s
        if self._limits and control.passes and not control.done:
            counts = {kind: (int(control[word]), what) for kind, (word, what) in KINDS.items()}
            late = int(self._block["histogram"][Stage.WAKE_LATE, self._past :].sum())
            for kind, (count, text) in ({"late": (late, self._late)} | counts).items():
                if rose := self._rose(kind, count, now_s):
                    k = int(control.cycle)
                    yield Alarm(self._node, kind, k, 1e-9 * k * self._period_ns, rose, text)

    def _rose(self, kind: str, count: int, now_s: float) -> int:
        """Return by how much a counter rose, if that is an alarm, else 0."""
        rose, limit = count - self._told[kind], self._limits.get(f"{kind}_per_s", 0.0)
        if now_s < self._quiet_s[kind] and rose >= 0:
            return 0
        alarm = limit is not None and rose > limit
        if alarm:
            self._quiet_s[kind] = now_s + EVERY_S
        if alarm or rose < 0 or now_s >= self._second_s[kind]:  # below 0: it was reset
            self._told[kind], self._second_s[kind] = count, now_s + EVERY_S
        return rose if alarm else 0
