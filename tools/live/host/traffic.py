"""What the frames of a running node take of the bus, and how regularly each kind comes."""

import functools
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.executive.loop.ring_layout import OfFrame, frame_words
from pcpc.executive.nodes.live import Live
from pcpc.executive.rig.bus_keys import Bus
from pcpc.tools.start import bus_load

LOOK_S = 1.0  # over which a load is measured
_SPAN_NS = 3_000_000_000  # of which periods are, on the clock of the node


@dataclass(frozen=True)
class FrameKind:
    """A kind of frame that a node knows: `way` rx or tx, `signals` name -> variable."""

    number: int
    name: str
    way: str
    signals: Mapping[str, str]


def _frame_kinds(live: Live) -> list[FrameKind]:
    """Return the kinds of frames that a node sends or receives."""
    kinds = []
    for word, name in live.block.description["frames"].items():
        for way in ("rx", "tx"):
            start = f"{way}.{name}."
            own = {n.removeprefix(start): n for n in live.variables if n.startswith(start)}
            if own:
                kinds.append(FrameKind(int(word) & can_id.ID, name, way, own))
    return kinds


class Traffic:
    """The frames of one node: `seen` and `sent`, by kind, in the last `over_s` seconds."""

    def __init__(self, live: Live) -> None:
        self.kinds = _frame_kinds(live)
        self._live, self._new = live, list[NDArray[np.int64]]()
        self._lately = np.zeros((0, frame_words(live.block.description)), np.int64)
        self._since_s, self._cycle = time.monotonic(), int(live.block.control.cycle)
        facts = live.block.description["metadata"]
        self._clocked = facts.get("pacing") not in WITHOUT_CLOCK
        self.seen, self.sent, self.over_s = bus_load.Kinds(), bus_load.Kinds(), 0.0
        self.spacing: dict[tuple[int, bool], tuple[float, float]] = {}

    def add(self, frames: NDArray[np.int64]) -> None:
        """Take the frames that have come; now and then look at them.

        Shape (n, columns of the ring).
        """
        self._new.append(frames)
        now_s = time.monotonic()
        if now_s - self._since_s >= LOOK_S:
            self._look(now_s)

    def _look(self, now_s: float) -> None:
        cycle = int(self._live.block.control.cycle)
        cycles_s = 1e-9 * self._live.period_ns * (cycle - self._cycle)
        self.over_s = now_s - self._since_s if self._clocked else cycles_s
        self._since_s, self._cycle = now_s, cycle
        new, self._new = np.concatenate(self._new), []
        counted = bus_load.FrameCounts(new)
        self.seen, self.sent = counted.seen, counted.sent
        lately = np.concatenate((self._lately, new))
        stamps = lately[:, OfFrame.STAMP_NS]
        self._lately = lately[stamps > stamps[-1:] - _SPAN_NS]
        self.spacing = bus_load.spacing(self._lately)

    @functools.cached_property
    def bus(self) -> Bus:
        """The bus of the rig, with its bit rates."""
        return bus_load.bus_of(self._live.block.description)

    def timed(self, number: int, way: str) -> dict[str, float]:
        """Return period and jitter, ms, of the frame of an id, received (rx) or sent (tx)."""
        for word in (number, number | can_id.EXTENDED):
            if both := self.spacing.get((word, way == "rx")):
                return {"period_ms": 1e3 * both[0], "jitter_ms": 1e3 * both[1]}
        return {}


def load(nodes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the load of a run's nodes: bit/s at most, of the fuller bus and by sender; bit rate.

    Empty as long as nothing is known.
    """
    traffic = {role: node.traffic for role, node in nodes.items()}
    over_s = max(one.over_s for one in traffic.values())
    if over_s <= 0.0:
        return {}
    bus = next(iter(traffic.values())).bus
    seen = {role: one.seen for role, one in traffic.items()}
    sent = {role: bus_load.bits(one.sent, bus.data_bit) for role, one in traffic.items()}
    return {
        "bitrate": bus.bits_per_s,
        "bits_per_s": max(bus_load.on_buses(seen, bus.data_bit)) / over_s,
        "sent": {role: bits / over_s for role, bits in sent.items()},
    }
