"""What the frames that nodes saw took of their bus, at most, and how regularly they came.

bits     of each frame as many as one of its length can have (`drivers.can.frame_bits`)
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
from pcpc.drivers.can.frame_bits import classic_bits
from pcpc.executive.loop.ring_layout import OfFrame
from pcpc.executive.rig import schema, yamlfile

Kinds = Counter[tuple[int, int]]  # frames by id word and length
_ID, _LENGTH, _RECEIVED, _STATE = 0xFFFFFFFF, 32, 40, 48  # in a word of a frame


class Counted:
    """Frames of a node's ring, (n, FRAME_WORDS), by kind."""

    def __init__(self, rows: NDArray[np.int64]) -> None:
        self.seen, self.sent = Kinds(), Kinds()
        self.received: dict[int, Counter[int]] = {}  # by id word and state
        words, counts = np.unique(rows[:, OfFrame.ABOUT], return_counts=True)
        for word, count in zip(words.tolist(), counts.tolist(), strict=True):
            number, state = word & _ID, word >> _STATE & 0xFF
            kind = number, word >> _LENGTH & 0xFF
            self.seen[kind] += count * (state != FrameState.BUS_ERROR)
            if word >> _RECEIVED & 0xFF:
                self.received.setdefault(number, Counter())[state] += count
            else:
                self.sent[kind] += count


def bits(kinds: Kinds) -> int:
    """Return the most bits that frames have on the wire."""
    return sum(
        count * classic_bits(min(length, 8), bool(number & can_id.EXTENDED))
        for (number, length), count in kinds.items()
    )


def on_buses(seen: Mapping[str, Kinds]) -> list[int]:
    """Return the bits on each bus of a run, of what its nodes saw; executive's bus first.

    A local node is on both buses and has seen what went over either.
    """
    ends = [seen[role] for role in ("executive", "plant") if role in seen]
    if "local" in seen:
        return [bits(end) for end in ends] or [bits(seen["local"])]
    most = Kinds()
    for end in ends:
        most |= end
    return [bits(most)]


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


def bitrate(about: Mapping[str, Any]) -> int | None:
    """Return the bit rate that the rig of a node's description says, None for none."""
    data = yamlfile.load("rig.yaml", about["attachments"]["rig-resolved.yaml"]).data["bus"]
    return msgspec.convert(data, schema.Bus).bits_per_s
