"""A recorded node recomputed: what it received is fed to the same cycle, in the same cycles.

    frames    those received in cycle k are checked and decoded again before the pass of cycle k
    tunings   those of cycle k are written before that pass; the rig's schedule is among them
    clock     k, passes, wake-up and stage times are the record's: laws and frames may use them
    bus       a failure of the bus is an input too: it is taken from the recorded fault
    end       a ramp of the commands to safe values begins in the cycle in which it did
    result    every recorded variable, every counter that follows from frames, every frame sent

Nothing else enters a cycle, so the result is bit-identical whatever the pacing and the bus were.
Not compared, because they were measured: stage times, late and skipped cycles, and the frames that
a node sends while it looks for the other one or ends.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can.e2e_states import FrameState, are_of_wire
from pcpc.executive.laws.emath_selftest import selftest
from pcpc.executive.laws.idle import idle
from pcpc.executive.log import reader as logs
from pcpc.executive.log.provenance import facts
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.control import COUNTERS
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.ring_layout import RECORD_HEAD, OfFrame
from pcpc.executive.loop.states import State
from pcpc.executive.loop.variables import COUNTED, GAIN
from pcpc.executive.nodes.install import install_in_memory
from pcpc.executive.nodes.plan import Plan, describe, plan
from pcpc.executive.nodes.recompute import (
    BUS_FAILED,
    COLUMNS,
    ENDS,
    FRAMES_END,
    TUNINGS_END,
    recompute,
)
from pcpc.executive.nodes.slices import HEAD, K, Slice
from pcpc.executive.nodes.watched import watched_result
from pcpc.executive.rig.buses import virtual_pacing
from pcpc.executive.rig.messages import is_heartbeat
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role

_OF_THE_MACHINE = ("late", "skipped", "send_errors")  # counters that no frame tells


@dataclass(frozen=True)
class Recomputation:
    """The same cycles recomputed, fewer if the node stopped; `values` (cycles, variables) bits."""

    values: NDArray[np.int64]
    sent: NDArray[Any]


class Replay:
    """One node of a rig, recomputed slice by slice."""

    def __init__(
        self, rig: Rig, role: Role, pacing: str, recorded: Collection[str],
        external: Sequence[str] = (), check: Callable[[Plan], None] = lambda made: None,
        metadata: dict[str, str] | None = None,
    ) -> None:  # fmt: skip
        """`pacing` and the variables `recorded` are the recorded run's. RigError, BusError.

        `external`: blocks that were stepped from outside; what they wrote is taken from the record.
        `check`: of VirtualRun. `metadata`: of a log that is written of it.
        """
        selftest()
        made = plan(rig, role, virtual_pacing(rig) if pacing == "virtual" else pacing)
        check(made)
        made.external = dict.fromkeys(external, idle.entry)
        written = metadata is not None
        self.block = sh.private(describe(made, metadata or facts(), kept=written))
        loop = self.block.loop
        install_in_memory(made, loop)
        loop.clock.kind, loop.tuning.n, loop.meeting.ordered = Time.GIVEN, 0, 0
        self.plan, self.steps = made, made.steps  # the plan keeps open what its blocks have opened
        description = self.block.description
        counted = [name for name in COUNTED if name in recorded]
        self.names = [*description["state_columns"], *counted]
        counters = [description["timing_columns"].index(name) for name in counted]
        states = RECORD_HEAD + np.arange(len(description["state_columns"]))
        self._columns = [*states, *(states[-1] + 2 + i for i in counters)]
        self._table, self._index = made.table, made.table.index
        measured = [name for name in description["timing_columns"] if name not in COUNTED]
        self._clocks = [name for name in measured if name in recorded]
        self._given = [
            f"{spec.name}.{name}"
            for spec in made.spec.blocks
            if spec.name in external
            for port in (*spec.block.outputs, *(spec.block.states if spec.is_opaque else ()))
            if port.recorded
            for name in port.names()
        ]
        places = [self._index[name] for name in (*self._clocks, *self._given)]
        self._places = np.array(places, np.int64)
        self._gain = np.array([loop.guard.gain])  # of the cycle before the next slice
        self._clocked = np.zeros((1, len(self._clocks)))  # of the cycle before the next slice
        self.needed = ["supervisor.fault", *self._clocks, *self._given]  # of a record
        self._heartbeats = [f.can_id for f in made.tx_frames if is_heartbeat(f)]

    def begin_at(self, put: Callable[[Plan, Loop], None]) -> None:
        """Let the node, which has done no cycle yet, begin in the state in which `put` puts it."""
        loop = self.block.loop
        put(self.plan, loop)
        self._gain = np.array([loop.v[GAIN]])
        self._clocked = np.array([loop.v[self._places[: len(self._clocks)]]])

    def advance(self, part: Slice, names: Sequence[str]) -> Recomputation:
        """Recompute the cycles of `part`, whose variables are `names`. Raises StepError."""
        wire = are_of_wire(part.frames["e2e"])  # others are put in their place again
        received = part.frames[(part.frames["direction"] == 1) & wire]
        raw = logs.on_bus(received)
        raw[:, 6] = received["e2e"] == FrameState.FOREIGN
        tunings = [t for t in part.tunings if t[1] in self._index]
        for tuning in tunings:
            self.check_tuning(*tuning)
        tuned = np.array([self._index[t[1]] for t in tunings], np.int64)
        values = np.array([t[2] for t in tunings], np.float64)
        rows = np.zeros((len(part.rows), COLUMNS), np.int64)
        rows[:, :HEAD] = part.rows[:, :HEAD]
        fault = part.rows[:, HEAD + names.index("supervisor.fault")].view(np.float64)
        rows[:, BUS_FAILED] = fault == Fault.BUS_FAILED
        gain, state = (
            part.rows[:, HEAD + names.index(f"supervisor.{name}")].view(np.float64)
            for name in ("gain", "state")
        )
        before = np.concatenate((self._gain, gain[:-1]))
        self._gain = gain[-1:]
        rows[:, ENDS] = (gain < before) & (state < State.FAULT)  # after a reset it rises
        times = np.array([t[0] for t in tunings], np.int64)
        for column, ends in ((FRAMES_END, received["cycle"]), (TUNINGS_END, times)):
            rows[:, column] = np.searchsorted(ends, rows[:, K], side="right")
        both = self._clocked_before(part, names), self._written_values(part, names)
        clocked = np.ascontiguousarray(np.hstack(both))
        heard = np.ascontiguousarray(received["cycle"]).astype(np.int64)
        places, done = self._places, np.zeros(2, np.int64)
        recording = rows, raw, heard, times, tuned, values, places, clocked, done
        loop = self.block.loop
        watched_result(lambda: recompute(loop, self.steps, recording), [loop])
        self._new_rows("event")
        return Recomputation(self._new_rows("record")[:, self._columns], self.sent(self._frames()))

    def repeat_clocks(self, part: Slice, names: Sequence[str], done: int) -> None:
        """Let the last `done` rows, and the counters, hold what was measured in those of `part`.

        For a log that goes on: what frames take from there is in it again.
        """
        ring, columns = self.block["record"], self.block.description["timing_columns"]
        put = int(self.block.ends("record").head)
        rows = np.arange(put - done, put) % len(ring)
        first = RECORD_HEAD + len(self.block.description["state_columns"]) + 1
        for name in self._clocks:
            ring[rows, first + columns.index(name)] = part.rows[:done, HEAD + names.index(name)]
        loop, last = self.block.loop, ring[rows[-1]].view(np.float64)
        loop.v[self._places[: len(self._clocks)]] = self._clocked[-1]
        for word, name, _ in COUNTERS:
            if word in _OF_THE_MACHINE and name in self._clocks:
                loop.control[word] = int(last[first + columns.index(name)])

    def check_tuning(self, cycle: int, name: str, value: float) -> None:
        """Raise LogError for a tuning that no node takes."""
        variable = self._table.variables[self._index[name]]
        tuning = f"cycle {cycle}: the log has a tuning of {name} to {value:g}"
        if variable.kind != "parameter":
            raise logs.LogError(f"{tuning}, which is no parameter; it is damaged or made up")
        if not (variable.low <= value <= variable.high and math.isfinite(value)):
            ends = f"{variable.low:g}..{variable.high:g}"
            raise logs.LogError(f"{tuning}, outside {ends}; it is damaged or made up")

    def _clocked_before(self, part: Slice, names: Sequence[str]) -> NDArray[np.float64]:
        """Return what was measured in the cycle before each of `part`; keep that of the last."""
        bits = part.rows[:, [HEAD + names.index(name) for name in self._clocks]]
        clocked = np.concatenate((self._clocked, bits.view(np.float64)))
        self._clocked = clocked[-1:]
        return np.ascontiguousarray(clocked[:-1])

    def _written_values(self, part: Slice, names: Sequence[str]) -> NDArray[np.float64]:
        """Return what blocks that were stepped from outside wrote in each cycle of `part`."""
        columns = [HEAD + names.index(name) for name in self._given]
        return part.rows[:, columns].view(np.float64)

    def sent(self, frames: NDArray[Any]) -> NDArray[Any]:
        """Return those of `frames`, (n,) both, that a cycle sent: none of the first meeting."""
        return frames[(frames["direction"] == 0) & ~self._is_meeting(frames)]

    def _is_meeting(self, frames: NDArray[Any]) -> NDArray[np.bool_]:
        return (frames["cycle"] == 0) & np.isin(frames["id"], self._heartbeats)

    def repeat_meeting(self, frames: NDArray[Any]) -> None:
        """Note again what of `frames` the node sent while it met the others, without a clock.

        The last heartbeat of cycle 0 is that of the cycle itself. `frames`: (n,) records.
        """
        loop, block = self.block.loop, self.block
        sent = frames[(frames["direction"] == 0) & self._is_meeting(frames)].copy()
        sent = sent[: max(len(sent) - len(self._heartbeats), 0)]
        sent["stamp_ns"] = 0
        block["frame"][: len(sent), OfFrame.HEADER] = sh.CDR_HEADER
        block["frame"][: len(sent), OfFrame.STAMP_NS :] = sent[:, None].view(np.int64)
        block.ends("frame").head = len(sent)
        loop.control.sent += len(sent)

    def _frames(self) -> NDArray[Any]:
        rows = np.ascontiguousarray(self._new_rows("frame")[:, 1:])
        return rows.view(logs.frame_type(self.block.description))[:, 0]

    def _new_rows(self, ring: str) -> NDArray[np.int64]:
        """Take what the loop put into a ring."""
        rows, taken_word = self.block[ring], self.block[f"{ring}_taken"]
        put, taken = int(self.block.ends(ring).head), int(taken_word[0])
        taken_word[0] = put
        return np.asarray(rows[np.arange(taken, put) % len(rows)])
