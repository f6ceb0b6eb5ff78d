"""The law of a rig, fed with what a plant sent to a device, and compared with what the device sent.

    sample k    the plant's frames of its cycle k: what the device took in its own cycle k
    answer k    what the plant received in its cycle k + 1, SYNC(k + 1) the last of it

Without a clock that order is certain, so the answers of a device that computes the rig's law are
those of the executive, bit for bit. Only frames that the plant hears are in its log. Heartbeats of
the first cycle and what a device sends at its end, or beyond that of the rig, are not compared.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can.e2e_states import FrameState
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.plan import cycles_of
from pcpc.executive.nodes.replay import Replay
from pcpc.executive.nodes.rings import kept_cycles
from pcpc.executive.nodes.slices import HEAD, PASSES, Assembler, K, Slice
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.replayed import Verdict, compare_frames
from pcpc.tools.make.device.below import NodesBelow

ROLE = "device"
_ASSUMED = {"supervisor.fault": 0.0, "supervisor.gain": 1.0, "supervisor.state": float(State.RUN)}


def is_of_device(head: logs.Log) -> bool:
    """Return whether a log is that of a plant with a device whose order is certain."""
    pacing = head.metadata.get("plant", {}).get("pacing")
    return "executive" not in head.node and "plant" in head.node and pacing == "lockstep"


class DeviceComparison:
    """A device's frames against the rig's law, piece by piece; as `NodeComparison` in after.replay.

    `each` is called with the frames of a piece that are compared, the device's and the law's.
    """

    def __init__(
        self, head: logs.Log, rig: Rig, each: Callable[..., object] = lambda *both: None
    ) -> None:
        self.below, self.role = NodesBelow(rig), rig.config.below[0]  # the node whose record it is
        self.recorded, self._each = Assembler([]), each
        self.replay = Replay(rig, "executive", "lockstep", [])
        self.recorded.most = kept_cycles(self.replay.block)
        names = [one.name for one in self.replay.plan.table.variables]
        self._schedule = [(k, names[place], value) for k, place, value in self.replay.plan.schedule]
        heard = [frame for _, frame in self.below.heard]
        self._heard = [frame.can_id for frame in heard]
        self._beats = [frame.can_id for frame in heard if messages.is_heartbeat(frame)]
        self.verdict = Verdict(ROLE, rig.config.rate_hz)
        about = head.node["plant"].description
        self._answers = self._computed = np.empty(0, logs.frame_type(about))
        self._cycles = self.verdict.planned = cycles_of(rig)
        self._ended = False
        self._begin_s = time.monotonic()

    def take(self, piece: logs.Log, whole: int, last: bool) -> None:
        """Recompute what `piece` completes, up to the plant's cycle `whole`; LogError."""
        if self.role in piece.node:
            self.recorded.add(self.below.record(piece))
        for part in self.recorded.take(whole, last):
            self._advance(part)
            self._compare(int(part.rows[-1, K]))
        self.verdict.missing += piece.missing
        if last and not self.verdict.anything and not self.verdict.differences:
            self.verdict.incomplete = "the plant's log holds no cycle that a device has answered"
        self.verdict.spent_s = time.monotonic() - self._begin_s

    def _advance(self, part: Slice) -> None:
        """Let the law work on the samples of a slice."""
        frames = part.frames
        answers = frames[(frames["direction"] == 1) & (frames["e2e"] != FrameState.FOREIGN)]
        greeting = (answers["cycle"] <= 1) & np.isin(answers["id"], self._beats)
        self._answers = np.concatenate((self._answers, answers[~greeting]))
        if self._ended:
            return
        samples = frames[frames["direction"] == 0].copy()
        samples["direction"], samples["e2e"] = 1, FrameState.OK
        rows = np.zeros((len(part.rows), HEAD + len(_ASSUMED)), np.int64)
        rows[:, :HEAD] = part.rows[:, :HEAD]
        rows[:, PASSES] = rows[:, K]
        rows[:, HEAD:] = np.array(list(_ASSUMED.values())).view(np.int64)
        first, last = part.rows[0, K], part.rows[-1, K]
        tunings = [one for one in self._schedule if first <= one[0] <= last]
        done = self.replay.advance(Slice(rows, samples, tunings), list(_ASSUMED))
        self._ended = len(done.values) < len(rows)
        sent = done.sent[np.isin(done.sent["id"], self._heard)]
        self._computed = np.concatenate((self._computed, sent))

    def _compare(self, last: int) -> None:
        """Compare the answers that the plant has had by its cycle `last`."""
        last = min(last, self._cycles)
        answered: NDArray[Any] = self._answers[self._answers["cycle"] <= last].copy()
        answered["cycle"] = np.maximum(answered["cycle"] - 1, 0)
        self._answers = self._answers[self._answers["cycle"] > last]
        computed = self._computed[self._computed["cycle"] < last]
        self._computed = self._computed[self._computed["cycle"] >= last]
        compare_frames(self.verdict, answered, computed)
        self._each(answered, computed)
        self.verdict.cycles = last
