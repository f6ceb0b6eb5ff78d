"""WIDTH runs of one rig in lanes: laid out once, then filled with settings and run, many times.

What cannot run in lanes is said by NotInLanes when the group is made (a third node, a law that does
not compile for lanes, a wire from what only a clock knows), or by LanesDiffer when it runs (the
lanes would take different branches). Such runs are done one by one, with the same bits.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.jit import LOOP_INTERPRETED
from pcpc.drivers.compiled.lanes import WIDTH, LanesDiffer, table
from pcpc.drivers.compiled.stage import Stage
from pcpc.executive.batch import cycle
from pcpc.executive.log.description import NodeDescription, node_description
from pcpc.executive.loop import draws, exchange, reception
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.control import COUNTERS, Control
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.variables import (
    COUNTERS_AT,
    DISARMED,
    ERROR_REGISTER,
    GAIN,
    RESET_ASKED,
    STATUS_WORD,
    STOP_ASKED,
    TIMING,
    TIMING_AT,
    WALL,
)
from pcpc.executive.nodes.install import install_in_memory
from pcpc.executive.nodes.parts import PARTS
from pcpc.executive.nodes.plan import Plan, cycles_of, describe, plan
from pcpc.executive.nodes.planned_controllers import standby_copies
from pcpc.executive.nodes.watched import StepError, watched_result
from pcpc.executive.own_laws.law_errors import cause
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role

Traces = dict[Role, NDArray[np.float64]]
_AT_ONCE = 256  # rows of a trace turned at once: they fit the nearest memory
PIECE = 4000  # cycles between two looks at whether the user wants the end; each takes a thread
_WHOLE = 2.0**53  # the largest code that float64 counts exactly


class NotInLanes(Exception):
    """Why runs of this rig are done one by one."""


class LaneGroup:
    """The memory of WIDTH runs; `plans` by role, `seats` executive and plant."""

    def __init__(
        self, rig: Rig, wanted: Mapping[Role, Sequence[str]], traces: Traces | None = None
    ) -> None:
        """`wanted`: the variables to keep traces of, by node. RigError, BusError, NotInLanes.

        `traces`: memory for them, shared by groups of which one runs at a time.
        """
        if LOOP_INTERPRETED:
            raise NotInLanes("nothing is compiled")
        if rig.roles != ("executive", "plant"):
            raise NotInLanes(f"it has the nodes {', '.join(rig.roles)}")
        reasons = ["its line is emulated"] * (rig.config.bus.emulate is not None)
        reasons += filter(None, (part.in_no_lane(rig) for part in PARTS))
        if reasons:
            raise NotInLanes(", ".join(reasons))
        self.cycles = cycles_of(rig)
        self.plans: dict[Role, Plan] = {role: plan(rig, role, "lockstep") for role in rig.roles}
        self._blocks = {
            role: sh.private(describe(made, {}, kept=False)) for role, made in self.plans.items()
        }
        self.described: dict[Role, NodeDescription] = {
            role: node_description(block.description) for role, block in self._blocks.items()
        }
        for role, made in self.plans.items():
            install_in_memory(made, self._blocks[role].loop)
            _check_wires(made)
        top, low = (block.loop for block in self._blocks.values())
        exchange.meet((top, low))
        reception.receive(low)
        self.seats: dict[Role, cycle.Seat] = {}
        others = reversed(self.plans.values())
        for (role, made), other in zip(self.plans.items(), others, strict=True):
            names = wanted.get(role, ())
            trace = _trace({} if traces is None else traces, role, (self.cycles + 1) * len(names))
            self.seats[role] = _seat(made, self._blocks[role].loop, other, names, trace)
        self._kept = {
            role: standby_copies(made.spec, made.table) for role, made in self.plans.items()
        }
        self._lossy = [  # where the state of a generator of losses stands, of which frame
            (role, int(cycle.of_frame.py_func(seat.n, row)) + cycle.SEED, frame.name)
            for role, seat in self.seats.items()
            for row, frame in enumerate(self.plans[role].rx_frames)
            if seat.n.rx.loss[row].enter > 0.0
        ]
        self._begin = {role: _beginning(role, seat) for role, seat in self.seats.items()}
        for role, seat in self.seats.items():
            asks, guard = {RESET_ASKED, STOP_ASKED, DISARMED}, seat.n.guard
            requests = {place for _, place, _ in self.plans[role].schedule} & asks
            if guard.estop_index >= 0 or guard.stop_row >= 0 or requests:
                raise NotInLanes("it may be stopped by a signal, a frame or its schedule")
        if low.guard.mode_index < 0 or low.limits.n > 0:
            raise NotInLanes("its plant is not told of the end, or has limits")

    def begin(self) -> None:
        """Put the rig's own values into all lanes."""
        for role, seat in self.seats.items():
            seat.values[:] = self._begin[role][:, None]
            seat.n.tuning.done = 0
            seat.n.control.stepping = seat.n.control.fault = 0

    def put(self, lane: int, role: Role, values: Mapping[int, float]) -> None:
        """Give a run values by their places in the table of a node."""
        kept = {place: values[state] for place, state in self._kept[role] if state in values}
        both = {**values, **kept}
        self.seats[role].values[list(both), lane] = list(both.values())

    def put_seed(self, lane: int, seed: int) -> None:
        """Give the losses of a run their seed."""
        for role, place, frame in self._lossy:
            self.seats[role].values[place, lane] = draws.first(seed, frame)

    def repeat(self, lane: int, others: Sequence[int]) -> None:
        """Let other lanes do what a lane does."""
        for seat in self.seats.values():
            seat.values[:, others] = seat.values[:, lane : lane + 1]

    def run(self) -> NDArray[np.bool_]:
        """Run all lanes to the end; return which are odd: all, where a step ends with an exception.

        Shape (WIDTH,). Raises LanesDiffer; StepError, named, for a step that does not return.
        """
        top, low = self.seats["executive"], self.seats["plant"]
        for first in range(0, self.cycles, PIECE):
            try:
                differ = watched_result(partial(self._piece, first), (top.n, low.n))
            except StepError:
                for role, seat in self.seats.items():
                    if what := hanging_step(self.described[role], seat.n.control):
                        raise StepError(what) from None
                return np.ones(WIDTH, np.bool_)
            if differ:
                raise LanesDiffer("the lanes differ")
        cycle.finish(top, low, self.cycles)
        odd = [seat.values[seat.n.n_variables + cycle.ODD] for seat in (top, low)]
        found: NDArray[np.bool_] = (odd[0] != 0.0) | (odd[1] != 0.0)
        return found

    def columns(self) -> Traces:
        """Return what was kept, by node: (wanted, WIDTH, cycles)."""
        traces = {}
        for role, seat in self.seats.items():
            rows = seat.trace.reshape(self.cycles + 1, -1)
            columns = np.empty((rows.shape[1], len(rows)))
            for first in range(0, len(rows), _AT_ONCE):
                columns[:, first : first + _AT_ONCE] = rows[first : first + _AT_ONCE].T
            traces[role] = columns.reshape(-1, WIDTH, len(rows))
        return traces

    def _piece(self, first: int) -> bool:
        """Do a piece of the cycles; return whether the lanes differ in it."""
        top, low = self.seats["executive"], self.seats["plant"]
        try:
            cycle.advance(top, low, first, min(first + PIECE, self.cycles))
        except LanesDiffer:
            return True
        return False


def hanging_step(description: Mapping[str, Any], control: Control) -> str:
    """Return which step of a node does not return; "" for none."""
    if control.fault != Fault.STEP_HANGS:
        return ""
    return f"the step of {description['blocks'][control.stepping - 1]} does not return"


def _check_wires(made: Plan) -> None:
    names, n_clock = made.names, len(TIMING)
    if any(frame.on_event for frame in made.tx_frames):
        raise NotInLanes("it has an emergency frame")
    known = {*range(COUNTERS_AT, COUNTERS_AT + len(COUNTERS)), WALL}
    for source, _ in (pair for copies in made.copies for pair in copies):
        if TIMING_AT <= source < TIMING_AT + n_clock and source not in known:
            raise NotInLanes(f"{names[source]} is wired, which only a clock knows")
        if STATUS_WORD <= source <= ERROR_REGISTER:
            raise NotInLanes(f"{names[source]} is wired")
    for spec in made.spec.blocks:
        if not isinstance(spec.block.step, Stage):
            raise NotInLanes(f"the step of {spec.name} is none of pcpc's stages")


def _trace(traces: Traces, role: Role, rows: int) -> NDArray[np.float64]:
    """Return memory for `rows` LANEs, as much as is needed of what there is."""
    if role not in traces or len(traces[role]) < rows * WIDTH:
        traces[role] = table(rows).reshape(-1)
    return traces[role][: rows * WIDTH]


def _seat(
    made: Plan, loop: Loop, other: Plan, wanted: Sequence[str], trace: NDArray[np.float64]
) -> cycle.Seat:
    for signal in (signal for frame in made.tx_frames for signal in frame.signals):
        if not signal.is_float and max(map(abs, signal.codes)) >= _WHOLE:
            raise NotInLanes(f"signal {signal.name} has codes beyond 2^53")
    if layered := [frame.name for frame in made.tx_frames if frame.selector]:
        raise NotInLanes(f"frame {layered[0]} is multiplexed")
    rows = {frame.name: row for row, frame in enumerate(other.rx_frames)}
    heard = np.array([rows.get(frame.name, -1) for frame in made.tx_frames], np.int64)
    places = np.array([made.table.index[name] for name in wanted], np.int64)
    return cycle.Seat(loop, table(cycle.rows_of(loop)), _entries(made), heard, places, trace)


def _entries(made: Plan) -> NDArray[np.int64]:
    entries = []
    for spec in made.spec.blocks:
        try:
            entries.append(spec.block.step.entry_of_lanes)
        except Exception as error:  # numba has many
            raise NotInLanes(f"the step of {spec.name}: {cause(error)}") from error
    return np.array(entries, np.int64)


def _beginning(role: Role, seat: cycle.Seat) -> NDArray[np.float64]:
    """Return the values of a seat after the nodes have met, of the rig as it is."""
    loop, n = seat.n, int(seat.n.n_variables)
    values = np.zeros(len(seat.values))
    values[:n] = loop.v[:n]
    values[GAIN] = 1.0
    values[n + cycle.COMPLETE] = role == "executive"  # the plant's first cycle has no command
    control = loop.control
    for row, word in ((cycle.SENT, "sent"), (cycle.RECEIVED, "received")):
        values[n + row] = control[word]
    for i in range(loop.limits.n):
        values[n + cycle.EXTRA + i] = loop.limits.table[i].sent
    for row in range(loop.rx.n):
        at = n + cycle.EXTRA + loop.limits.n + cycle.OF_FRAME * row
        values[at + cycle.SEED] = loop.rx.loss_state[row].draw
        values[at + cycle.HEARD] = loop.rx.state[row].last_counter >= 0
    return values
