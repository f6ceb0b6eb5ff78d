"""The supervisor: its table is the documented one, FAULT is latched, STOP is final."""

import re
from itertools import product

import numpy as np
import pytest
from engine import SLEW10

from pcpc.executive.loop import states, strangers
from pcpc.executive.loop.faults import FAULT_NAMES, Fault
from pcpc.executive.loop.states import (
    HEARTBEATS,
    NEXT,
    STATE_NAMES,
    Condition,
    State,
    next_state,
)
from pcpc.executive.nodes.planned_run import PATIENCE_S
from pcpc.executive.nodes.watched import HANG_PERIODS, HANG_S
from pcpc.executive.rig.reading import load_rig

EVENTS = Condition.names()


def documented_table() -> dict[tuple[str, str], str]:
    """Return {(state, event): next state} as the module's docstring says."""
    lines = [line.split() for line in (states.__doc__ or "").splitlines()]
    head = next(i for i, words in enumerate(lines) if tuple(words) == EVENTS)
    rows = lines[head + 1 : head + 1 + len(STATE_NAMES)]
    return {(row[0], event): to for row in rows for event, to in zip(EVENTS, row[1:], strict=True)}


def step(
    state: int, fresh: bool, fault: int, stopping: bool, ramped: bool, disarmed: bool = False
) -> int:
    """Return the next state as a plain number."""
    return int(next_state(state, fresh, fault, stopping, ramped, disarmed))


ALL_INPUTS = list(product((False, True), range(len(FAULT_NAMES)), (False, True), (False, True)))


def test_the_documented_table_has_every_state_and_event() -> None:
    table = documented_table()
    assert set(table) == set(product(STATE_NAMES, EVENTS)), sorted(table)


@pytest.mark.parametrize(("state", "event"), list(product(STATE_NAMES, EVENTS)))
def test_the_table_is_the_documented_one(state: str, event: str) -> None:
    code = NEXT[STATE_NAMES.index(state), EVENTS.index(event)]
    expected = documented_table()[state, event]
    assert STATE_NAMES[code] == expected, f"{state}/{event}: {STATE_NAMES[code]}"


@pytest.mark.parametrize("state", range(6), ids=STATE_NAMES)
def test_every_state_stops_on_request_whatever_else_happens(state: int) -> None:
    for fresh, fault, _, ramped in ALL_INPUTS:
        to = step(state, fresh, fault, True, ramped)
        assert to == State.STOP, f"{fresh=} {fault=} {ramped=}: {STATE_NAMES[to]}"


def test_nothing_leaves_STOP() -> None:
    for inputs in ALL_INPUTS:
        to = step(State.STOP, *inputs)
        assert to == State.STOP, f"{inputs}: {STATE_NAMES[to]}"


def test_FAULT_is_latched_until_the_ramp_is_over_or_a_reset_was_granted() -> None:
    for fresh, fault, stopping, ramped in ALL_INPUTS:
        to = step(State.FAULT, fresh, fault, stopping, ramped)
        expected = State.STOP if stopping or ramped else State.FAULT
        expected = State.INIT if fault == Fault.NONE and not stopping else expected
        assert to == expected, f"{fresh=} {fault=} {stopping=} {ramped=}: {STATE_NAMES[to]}"


def test_no_sequence_of_events_but_a_reset_leads_from_FAULT_back_to_the_closed_loop() -> None:
    reached, new = set(), {State.FAULT}
    while new:
        reached |= new
        new = {int(to) for state in new for to in np.delete(NEXT[state], Condition.RESET)} - reached
    assert reached == {State.FAULT, State.STOP}, [STATE_NAMES[s] for s in reached]


def test_a_fault_wins_over_fresh_input_and_a_stop_over_a_fault() -> None:
    for state in (State.INIT, State.READY, State.RUN, State.HOLD):
        for fault in range(1, len(FAULT_NAMES)):
            assert step(state, True, fault, False, False) == State.FAULT, (state, fault)
            assert step(state, True, fault, True, False) == State.STOP, (state, fault)


def test_only_fresh_input_closes_the_loop_in_two_steps() -> None:
    ways = {
        STATE_NAMES[a]: STATE_NAMES[step(a, True, 0, False, False)]
        for a in (State.INIT, State.READY, State.HOLD)
    }
    assert ways == {"INIT": "READY", "READY": "RUN", "HOLD": "RUN"}, ways
    for state in (State.INIT, State.READY):
        assert step(state, False, 0, False, False) == state, STATE_NAMES[state]


def test_who_is_disarmed_is_ready_at_most_and_everything_else_goes_before() -> None:
    for fresh, fault, stopping, ramped in ALL_INPUTS:
        for state in (State.READY, State.RUN, State.HOLD):
            to = step(state, fresh, fault, stopping, ramped, True)
            wanted = State.STOP if stopping else State.FAULT if fault else State.READY
            assert to == wanted, f"{state} {fresh=} {fault=} {stopping=}: {STATE_NAMES[to]}"
        for state in (State.INIT, State.FAULT, State.STOP):
            inputs = state, fresh, fault, stopping, ramped
            assert step(*inputs, True) == step(*inputs, False), inputs


def test_the_heartbeat_says_operational_exactly_where_the_loop_is_closed() -> None:
    said = dict(zip(STATE_NAMES, HEARTBEATS.tolist(), strict=True))
    expected = {"INIT": 127, "READY": 127, "RUN": 5, "HOLD": 5, "FAULT": 4, "STOP": 4}
    assert said == expected, said


def test_what_a_state_does_is_documented() -> None:
    lines = (states.__doc__ or "").splitlines()
    head = next(i for i, line in enumerate(lines) if line.split()[:2] == ["state", "runs"])
    told = [re.split(r"\s{2,}", line.strip()) for line in lines[head + 1 : head + 7]]
    nmt = {127.0: "pre-operational", 5.0: "operational", 4.0: "stopped"}
    columns = [(s.name, (s.runs, s.expects, s.ramps, s.sends), s.heartbeat) for s in State]
    expected = [
        [name, *(str(int(one)) for one in does), nmt[float(beat)]] for name, does, beat in columns
    ]
    assert told == expected


def test_the_limit_of_a_fault_is_a_key_of_the_rig_or_a_number_of_the_loop() -> None:
    config = load_rig(SLEW10).config
    for fault in list(Fault)[1:]:
        if isinstance(fault.within, str):
            section, _, key = fault.within.partition(".")
            assert hasattr(getattr(config, section), key), fault
        assert fault.within is not None or fault.why, fault
    foreign, repeated = Fault.ANOTHER_SENDER, Fault.REPEATED_INPUT
    counts = strangers.FOREIGN_FRAMES, strangers.REPEATED_FRAMES
    assert (foreign.within, repeated.within) == counts
    assert foreign.why == f"{counts[0]} frames in {strangers.FOREIGN_CYCLES} cycles"
    assert repeated.why == f"{counts[1]} frames in {strangers.REPEATED_CYCLES} cycles"
    silent, hangs = Fault.PEER_SILENT, Fault.STEP_HANGS
    assert f"after {PATIENCE_S:g} s" in silent.why
    assert hangs.why == f"after {HANG_S:g} s or {HANG_PERIODS:g} periods"


def test_faults_and_states_are_numbered_as_they_always_were() -> None:
    names = (
        "NONE", "INPUT_MISSING", "COMMAND_NOT_FINITE", "PEER_SILENT", "BUS_FAILED", "OVERRUN",
        "ANOTHER_SENDER", "REPEATED_INPUT", "OUTPUT_NOT_FINITE", "PLANT_NOT_FINITE", "STEP_RAISED",
        "STEP_HANGS", "EMERGENCY_STOP", "STOP_FRAME", "NOT_PLAUSIBLE", "INTRUSION", "BUS_OFF",
    )  # fmt: skip
    assert {fault.name: int(fault) for fault in Fault} == {name: i for i, name in enumerate(names)}
    assert State.names() == ("INIT", "READY", "RUN", "HOLD", "FAULT", "STOP")
