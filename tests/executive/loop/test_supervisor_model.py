"""The supervisor as a model to be checked: the compiled pieces under any order of events.

Hypothesis looks for a sequence of inputs, wishes, faults and requests that breaks what a supervisor
promises. A cycle is here what the loop does of it: supervise, then limit what is sent.
"""

import math
import tempfile
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from engine import Node, puppet_rig
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from pcpc.drivers.compiled.jit import i8, loop
from pcpc.executive.loop.cycle import N, hear_requests, supervise
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.limits import limit_commands, settled
from pcpc.executive.loop.states import NEXT, RAMPS, RUNS, STATE_NAMES, Condition, State
from pcpc.executive.nodes.plan import Plan, plan
from pcpc.executive.rig.reading import load_rig

LOW, HIGH, SAFE, RATE = -1.0, 2.0, 0.25, 0.125  # of the command; the last a cycle
RAMP_CYCLES = 8
WAY_CYCLES = math.ceil((HIGH - LOW) / RATE)
COMMAND, ESTOP = "tx.CMD.motor_torque", "rx.FB_A.encoder"
WISHES = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-4.0, 4.0)


@cache
def executive() -> Plan:
    """Return the plan of a node with a command of limited range and rate."""
    limit = f"{{low: {LOW}, high: {HIGH}, rate_per_s: {1000 * RATE}, safe: {SAFE}}}"
    lines = f"executive: {{limits: {{CMD.motor_torque: {limit}}}}}", "supervisor: {ramp_s: 0.008}"
    with tempfile.TemporaryDirectory() as folder:
        return plan(load_rig(puppet_rig(Path(folder), *lines)), "executive", "sync")


@loop(i8(N))
def _cycle(n: Any) -> Any:
    """Do what is the supervisor's of a cycle; return whether the command may be safe by now."""
    supervise(n)
    hear_requests(n)
    limit_commands(n)
    n.k += 1
    return settled(n.limits)


class Supervised(RuleBasedStateMachine):
    """A node; what happens to it, and what must hold in each of its cycles."""

    def __init__(self) -> None:
        super().__init__()
        self.node = Node(executive())
        self.n = self.node.loop
        self.state, self.gain, self.sent = State.INIT, 1.0, SAFE
        self.asked = self.reset = self.due = self.was_reset = self.pressed = False
        self.disarmed = False
        self.n.guard.estop_index = self.node.place(ESTOP)

    @initialize(waits=st.booleans(), manual=st.booleans())
    def begin(self, waits: bool, manual: bool) -> None:
        """Choose whether a fault waits for a reset, and whether the loop is closed by hand."""
        self.n.guard.waits = waits
        self.n.guard.manual = self.n.guard.disarmed = manual
        self.node["supervisor.disarmed"] = float(manual)
        if manual:
            self.n.guard.gain = self.gain = 0.0
            self.was_reset = True

    @property
    def over(self) -> bool:
        """Whether it has stopped, so that no cycle follows."""
        return self.state == State.STOP

    @precondition(lambda self: not self.over)
    @rule(fresh=st.booleans(), wish=WISHES)
    def cycle(self, fresh: bool, wish: float) -> None:
        """Do a cycle with or without complete input; `wish` is what the law wants."""
        n = self.n
        self.disarmed = n.guard.disarmed != 0
        n.rx.fresh = n.rx.awaited if fresh else 0
        if n.rx.awaited == 0:
            n.rx.fresh = 0
        self.node[COMMAND] = wish
        self.asked = self.asked or n.guard.stop != 0
        self.due, self.reset = n.guard.reset != 0, False
        _cycle(n)
        self.hold(fresh)

    @precondition(lambda self: not self.over)
    @rule(count=st.integers(1, 6), wish=WISHES)
    def cycles_without_input(self, count: int, wish: float) -> None:
        """Hear nothing for some cycles."""
        for _ in range(count):
            if not self.over:
                self.cycle(False, wish)

    @rule(fault=st.integers(1, len(Fault) - 1))
    def detect(self, fault: int) -> None:
        """Let a detector of the loop see a fault; the first one counts."""
        if self.n.guard.faulted == Fault.NONE:
            self.n.guard.faulted = fault

    @rule()
    def ask_to_stop(self) -> None:
        """Let the host ask for the end."""
        self.n.control.stop = 1
        self.asked = True

    @rule(disarmed=st.booleans())
    def arm_or_hold(self, disarmed: bool) -> None:
        """Let an operator arm it or hold it, for the cycle after next."""
        self.node["supervisor.disarmed"] = float(disarmed)

    @rule(quick=st.booleans())
    def ask_to_stop_as_a_client(self, quick: bool) -> None:
        """Let a client ask for it, for the cycle after next."""
        self.node["supervisor.stop"] = 1.0 + quick

    @rule()
    def ask_for_a_reset(self) -> None:
        """Let a client ask, at any time."""
        self.node["supervisor.reset"] = 1.0
        self.reset = True

    @rule(value=st.sampled_from([0.0, 0.0, 1.0, 2.0, -0.5]))
    def press(self, value: float) -> None:
        """Press or release the emergency stop: whatever is not 0 presses it."""
        self.node[ESTOP] = value
        self.pressed = value != 0.0

    @rule()
    def be_over(self) -> None:
        """Let the run have its duration."""
        self.n.guard.cycles = self.n.k
        self.asked = True

    def hold(self, fresh: bool) -> None:
        """Check what a cycle may do, against the one before."""
        before, gain, sent = self.state, self.gain, self.sent
        self.state = state = int(self.node["supervisor.state"])
        self.gain, self.sent = float(self.n.guard.gain), self.node[COMMAND]
        told = f"{STATE_NAMES[before]} to {STATE_NAMES[state]}, {sent} to {self.sent}"
        assert state in NEXT[before], told
        if before == State.FAULT and state not in (State.FAULT, State.STOP):
            assert state == State.INIT and self.due, f"{told}: FAULT is latched"
            assert fresh and not self.pressed and gain == 0.0 and abs(sent - SAFE) <= RATE, told
            self.was_reset = True
        assert not self.pressed or RAMPS[state], f"{told}: pressed"
        if state == State.RUN and state != before:
            assert fresh or self.asked, f"{told}: nothing fresh"
        if self.disarmed:
            assert not RUNS[state], f"{told}: disarmed"
        waits = self.disarmed and state == State.READY
        if state == State.HOLD:
            assert not fresh, told
        assert state != State.FAULT or self.node["supervisor.fault"] != Fault.NONE, told
        ramps = self.asked or bool(RAMPS[state]) or waits
        self.was_reset = self.was_reset or waits
        step = 1.0 / RAMP_CYCLES if self.was_reset and not ramps and state != State.INIT else 0.0
        assert self.gain <= gain + step, f"{told}: the gain rises from {gain} to {self.gain}"
        assert self.gain == 1.0 or ramps or self.was_reset, told
        self.hold_command(state, sent, told)
        assert self.n.control.state == state
        assert self.n.guard.reset == 0 or state == State.FAULT, f"{told}: a reset of no fault"

    def hold_command(self, state: int, sent: float, told: str) -> None:
        """Check what is sent: in range and rate in any case; safe before input, else on its way."""
        assert LOW <= self.sent <= HIGH, told
        assert abs(self.sent - sent) <= RATE * (1 + 1e-12), told
        if state == State.INIT:
            assert self.sent == SAFE, told
        if self.asked or RAMPS[state] or (self.disarmed and state == State.READY):
            assert abs(self.sent - SAFE) <= abs(sent - SAFE) + 1e-12, f"{told}: away from safe"

    def teardown(self) -> None:
        """Let it end: a fault stops in its time, with a safe command; STOP is final."""
        self.n.guard.waits = 0
        if self.state == State.FAULT:
            self.node["supervisor.reset"] = 0.0
            self.n.guard.reset = 0
            if self.n.guard.faulted == Fault.NONE:
                self.n.guard.faulted = Fault.OVERRUN
            for _ in range(RAMP_CYCLES + WAY_CYCLES + 2):
                if not self.over:
                    self.cycle(True, HIGH)
            assert self.over, f"still in FAULT, sent {self.sent}"
        if self.over:
            assert abs(self.sent - SAFE) <= RATE, f"stopped with a command of {self.sent}"
            self.n.guard.faulted = Fault.NONE
            for fresh in (True, False):
                _cycle(self.n)
                assert self.node["supervisor.state"] == State.STOP, f"STOP is left, {fresh=}"


Supervised.TestCase.settings = settings(
    max_examples=300, stateful_step_count=40, derandomize=True, deadline=None
)
TestSupervised = pytest.mark.quick(Supervised.TestCase)


@pytest.mark.parametrize("value", [1.0, 2.0, -0.5, 1e-300, math.nan])
@pytest.mark.parametrize("cycles", [0, 3])
def test_an_emergency_stop_is_pressed_by_whatever_is_not_0(cycles: int, value: float) -> None:
    node = Supervised()
    node.begin(waits=False, manual=False)
    for _ in range(cycles):
        node.cycle(True, HIGH)
    assert node.state == (State.RUN if cycles else State.INIT)
    node.press(value)
    node.cycle(True, HIGH)
    assert node.state == State.FAULT
    assert node.n.guard.faulted == Fault.EMERGENCY_STOP


@pytest.mark.parametrize("state", range(6), ids=STATE_NAMES)
def test_every_way_through_the_table_is_a_safe_one(state: int) -> None:
    """All ways of four events from each state: what each does on its way, from the table alone."""
    for events in product(range(NEXT.shape[1]), repeat=4):
        at, faulted, stopped = state, state == State.FAULT, state == State.STOP
        for event in events:
            before, at = at, int(NEXT[at, event])
            closes = RUNS[at] > RUNS[before]
            faulted = faulted and not (before == State.FAULT and event == Condition.RESET)
            way = f"{STATE_NAMES[state]} by {events}: {STATE_NAMES[before]} to {at}"
            assert not closes or (event == Condition.FRESH and not faulted), way
            assert not stopped or at == State.STOP, way
            assert not faulted or RAMPS[at], way
            assert event != Condition.LOSS or RAMPS[at], way
            assert event != Condition.STOP_REQUEST or at == State.STOP, way
            faulted, stopped = faulted or at == State.FAULT, stopped or at == State.STOP
