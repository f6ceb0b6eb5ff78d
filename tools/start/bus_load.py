"""What the frames that nodes saw took of their bus, at most, and how regularly they came.

bits     of each frame as many as one of its length can have (`drivers.can.frame_bits`)
         in nominal bits; one of CAN FD's data phase is less than one
load     of a bus; a frame counts once, by the node that saw most of it
sent     the part of it that is from one node
period   mean time from a frame to the next of its kind
jitter   the longest such time minus the shortest
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.can.frame_bits import frame_bits
from pcpc.drivers.can.wire_layout import Flag
from pcpc.executive.loop.ring_layout import OfFrame
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.bus_keys import Bus

Kinds = Counter[tuple[int, int, int]]  # frames by id word, length and `Flag`
_ID, _LENGTH, _RECEIVED, _STATE, _FLAGS = 0xFFFFFFFF, 32, 40, 48, 56  # in a word of a frame


class FrameCounts:
    """Frames of a node's ring, (n, FRAME_WORDS), by kind."""

    def __init__(self, rows: NDArray[np.int64]) -> None:
        self.seen, self.sent = Kinds(), Kinds()
        self.received: dict[int, Counter[int]] = {}  # by id word and state
        words, counts = np.unique(rows[:, OfFrame.ABOUT], return_counts=True)
        for word, count in zip(words.tolist(), counts.tolist(), strict=True):
            number, state = word & _ID, word >> _STATE & 0xFF
            kind = number, word >> _LENGTH & 0xFF, word >> _FLAGS & ~Flag.ESI
            self.seen[kind] += count * (state != FrameState.BUS_ERROR)
            if word >> _RECEIVED & 0xFF:
                self.received.setdefault(number, Counter())[state] += count
            else:
                self.sent[kind] += count


def bits(kinds: Kinds, data_bit: float) -> float:
    """Return the most nominal bits that frames last; `data_bit` of `executive.rig.Bus`."""
    total = 0.0
    for (number, length, flags), count in kinds.items():
        nominal, data = frame_bits(length, bool(number & can_id.EXTENDED), flags)
        total += count * (nominal + data_bit * data)
    return total


def on_buses(seen: Mapping[str, Kinds], data_bit: float) -> list[float]:
    """Return the bits on each bus of a run, of what its nodes saw; executive's bus first.

    A local node is on both buses and has seen what went over either.
    """
    ends = [kinds for role, kinds in seen.items() if role != "local"]
    if "local" in seen:
        return [bits(end, data_bit) for end in ends or [seen["local"]]]
    most = Kinds()
    for end in ends:
        most |= end
    return [bits(most, data_bit)]


def spacing(rows: NDArray[np.int64]) -> dict[tuple[int, bool], tuple[float, float]]:
    """Return period and jitter, s, by id word and whether it was received, of frames in order.

    A kind of which there are less than two has none. `rows`: (n, columns of the ring).
    """
    found = {}
    stamps, kinds = rows[:, OfFrame.STAMP_NS], rows[:, OfFrame.ABOUT] & (_ID | 1 << _RECEIVED)
    for kind in np.unique(kinds).tolist():
        apart = np.diff(stamps[kinds == kind])
        if len(apart):
            both = 1e-9 * float(apart.mean()), 1e-9 * float(np.ptp(apart))
            found[kind & _ID, bool(kind >> _RECEIVED)] = both
    return found


def bus_of(about: Mapping[str, Any]) -> Bus:
    """Return the bus of the rig of a node's description."""
    data = yamlfile.load("rig.yaml", about["attachments"]["rig-resolved.yaml"]).data["bus"]
    return msgspec.convert(data, Bus)
