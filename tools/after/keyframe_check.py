"""The keyframes of a log held against the state that a recomputed node has there, bit for bit.

Not compared: what clocks measured, and frames sent in the first meeting, which is not recomputed.

Of another layout, but as long as this version's, they count only if all have the bits of today's:
what differs may lie elsewhere, so it is no difference, and they are not compared.
"""

from pcpc.executive.log import reader as logs
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.log.keyframes import Keyframe, Keyframes, keyframe_of
from pcpc.executive.nodes import planned_keyframes
from pcpc.executive.nodes.replay import Replay
from pcpc.tools.after.differences import are_nan
from pcpc.tools.after.replayed import Verdict

OTHER_LAYOUT = (
    "its keyframes are not compared: their layout is of another version; the version that wrote "
    "the log compares them"
)
_KEPT = 64  # recomputed states of which the log may still bring the keyframe


class KeyframeCheck:
    """What a log has of a node's keyframes, and what the recomputed node has."""

    def __init__(self, replay: Replay, verdict: Verdict, recorded: NodeDescription) -> None:
        """Compare those of a log that says `recorded` of the node; none without it."""
        self._replay, self._verdict = replay, verdict
        self._own = Keyframes(replay.block)
        about = replay.block.description
        self._size, self._layout = about["keyframe_bytes"], recorded.get("keyframe_layout", "")
        self._is_known = self._layout == about["keyframe_layout"]
        is_as_long = recorded.get("keyframe_bytes") == self._size
        self.every = about["keyframe_passes"] if self._is_known or is_as_long else 0  # passes
        if recorded.get("keyframe_passes") and not self.every:
            verdict.from_record.append(OTHER_LAYOUT)
        self._recorded: dict[int, Keyframe] = {}
        self._recomputed: dict[int, bytes] = {}

    def add(self, node: logs.NodeLog, behind: int) -> None:
        """Take up the keyframes of a piece of the log, those of cycles later than `behind`."""
        for text in node.others.get("keyframes", ()) if self.every else ():
            try:
                frame = keyframe_of(text, 0, self._size, self._layout)
            except ValueError as error:
                self._leave_out(str(error))
                continue
            if frame is None:
                self._leave_out("it is of no cycle that a run has")
            elif frame.cycle > behind:
                self._recorded[frame.passes] = frame
                self._compare(frame.passes)

    def look(self) -> None:
        """Compare the state that the node has published since the last look, if it has."""
        if self.every and (found := self._own.newest()) is not None:
            self._recomputed[found.passes] = found.state
            self._compare(found.passes)
            for passes in list(self._recomputed)[:-_KEPT]:
                del self._recomputed[passes]

    def end(self, cycle: int) -> None:
        """Say which keyframes up to a cycle, the last that was asked for, belong to none."""
        for frame in self._recorded.values() if self.every else ():
            if frame.cycle <= cycle:
                self._leave_out(f"cycle {frame.cycle}, the log has no such pass")

    def _leave_out(self, why: str) -> None:
        self._verdict.missing.append(f"a keyframe of the {self._verdict.role} is left out: {why}")

    def _compare(self, passes: int) -> None:
        if passes not in self._recorded or passes not in self._recomputed:
            return
        frame, state = self._recorded.pop(passes), self._recomputed.pop(passes)
        plan = self._replay.plan
        both = planned_keyframes.differences(plan, frame.state, state)
        unequal = [one for one in both if not are_nan(*one[1:])]
        if unequal and not self._is_known:
            self._verdict.from_record.append(OTHER_LAYOUT)
            self._verdict.keyframes = self.every = 0
            self._recomputed.clear()
            return
        if unequal and (what := planned_keyframes.why_none(plan, frame.state)):
            self._leave_out(f"cycle {frame.cycle}, {what}")
            return
        self._verdict.keyframes += 1
        for name, old, new in unequal:
            time_s = frame.cycle / self._verdict.rate_hz
            self._verdict.differences.note(name, frame.cycle, time_s, old, new)
