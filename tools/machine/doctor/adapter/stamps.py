"""Whether stamps are those of the frames: each lies between the frame's sending and its reading.

    kernel      s_i <= t_i <= r_i on one clock                                               (1)
    hardware    s_i <= t_i - o <= r_i with one offset o for CHUNK frames, for clocks that
                differ by less than RATE                                                     (2)
    offset      max(t_i - r_i) <= o <= min(t_i - s_i)                                        (3)
    order       t_i rises with the order of arrival                                          (4)

s sent, r read, CLOCK_REALTIME; t the stamp. A clock that runs wrongly breaks (3) from chunk to
chunk: o may move by RATE times the time between them.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from pcpc.tools.machine.doctor.adapter.passes import Stamped

CHUNK = 200
RATE = 500e-6  # two quartzes differ by less
EPSILON_NS = 2_000  # of reading clocks
FEWEST = 100  # of which stamps are judged


@dataclass(frozen=True)
class StampFault:
    """How many stamps cannot be, and how far the worst is from where it could."""

    count: int
    worst_ns: int
    why: str


def kernel_fault(stamps: Sequence[Stamped]) -> StampFault | None:
    """Return what breaks (1), if something does."""
    outside = [
        max(one.sent_ns - one.stamp_ns, one.stamp_ns - one.read_ns) - EPSILON_NS for one in stamps
    ]
    wrong = [ns for ns in outside if ns > 0]
    return StampFault(len(wrong), max(wrong), "outside of sending and reading") if wrong else None


def hardware_fault(stamps: Sequence[Stamped]) -> StampFault | None:
    """Return what breaks (4), or (2), or (3) between chunks, if something does; of one end."""
    back = [a.stamp_ns - b.stamp_ns for a, b in itertools.pairwise(stamps)]
    if wrong := [ns for ns in back if ns > 0]:
        return StampFault(len(wrong), max(wrong), "go back")
    if 2 * (same := sum(ns == 0 for ns in back)) > len(stamps):
        return StampFault(same, 0, "stand still")
    chunks = [stamps[i : i + CHUNK] for i in range(0, len(stamps), CHUNK)]
    before: tuple[int, int, int] | None = None
    for chunk in chunks:
        drift_ns = RATE * (chunk[-1].read_ns - chunk[0].sent_ns) + EPSILON_NS
        low = max(one.stamp_ns - one.read_ns for one in chunk)
        high = min(one.stamp_ns - one.sent_ns for one in chunk)
        if low - high > drift_ns:
            return StampFault(len(chunk), low - high, "are not between sending and reading")
        if before is not None:
            moved_ns = max(low - before[1], before[0] - high)
            allowed_ns = RATE * (chunk[-1].read_ns - before[2]) + EPSILON_NS
            if moved_ns > allowed_ns:
                return StampFault(len(chunk), moved_ns, "run at another rate, or jump")
        before = low, high, chunk[0].sent_ns
    return None
