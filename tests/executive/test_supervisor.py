"""The supervisor: its table is the documented one, FAULT is latched, STOP is final."""

from itertools import product

import pytest

from pcpc.executive.loop import supervisor as sv

EVENTS = ("NONE", "FRESH", "MISSED", "LOSS", "STOP_REQUEST", "RAMPED")


def documented_table() -> dict[tuple[str, str], str]:
    """Return {(state, event): next state} as the module's docstring says."""
    lines = [line.split() for line in (sv.__doc__ or "").splitlines()]
    head = next(i for i, words in enumerate(lines) if tuple(words) == EVENTS)
    rows = lines[head + 1 : head + 1 + len(sv.STATE_NAMES)]
    return {(row[0], event): to for row in rows for event, to in zip(EVENTS, row[1:], strict=True)}


def step(state: int, fresh: bool, fault: int, stopping: bool, ramped: bool) -> int:
    """Return the next state as a plain number."""
    return int(sv.advance(state, fresh, fault, stopping, ramped))


ALL_INPUTS = list(product((False, True), range(len(sv.FAULT_NAMES)), (False, True), (False, True)))


def test_the_documented_table_has_every_state_and_event() -> None:
    table = documented_table()
    assert set(table) == set(product(sv.STATE_NAMES, EVENTS)), sorted(table)


@pytest.mark.parametrize(("state", "event"), list(product(sv.STATE_NAMES, EVENTS)))
def test_the_table_is_the_documented_one(state: str, event: str) -> None:
    code = sv.NEXT[sv.STATE_NAMES.index(state), EVENTS.index(event)]
    expected = documented_table()[state, event]
    assert sv.STATE_NAMES[code] == expected, f"{state}/{event}: {sv.STATE_NAMES[code]}"


@pytest.mark.parametrize("state", range(6), ids=sv.STATE_NAMES)
def test_every_state_stops_on_request_whatever_else_happens(state: int) -> None:
    for fresh, fault, _, ramped in ALL_INPUTS:
        to = step(state, fresh, fault, True, ramped)
        assert to == sv.STOP, f"{fresh=} {fault=} {ramped=}: {sv.STATE_NAMES[to]}"


def test_nothing_leaves_STOP() -> None:
    for inputs in ALL_INPUTS:
        to = step(sv.STOP, *inputs)
        assert to == sv.STOP, f"{inputs}: {sv.STATE_NAMES[to]}"


def test_FAULT_is_latched_until_the_ramp_is_over() -> None:
    for fresh, fault, stopping, ramped in ALL_INPUTS:
        to = step(sv.FAULT, fresh, fault, stopping, ramped)
        expected = sv.STOP if stopping or ramped else sv.FAULT
        assert to == expected, f"{fresh=} {fault=} {stopping=} {ramped=}: {sv.STATE_NAMES[to]}"


def test_no_sequence_of_events_leads_from_FAULT_back_to_the_closed_loop() -> None:
    reached, new = set(), {sv.FAULT}
    while new:
        reached |= new
        new = {int(to) for state in new for to in sv.NEXT[state]} - reached
    assert reached == {sv.FAULT, sv.STOP}, [sv.STATE_NAMES[s] for s in reached]


def test_a_fault_wins_over_fresh_input_and_a_stop_over_a_fault() -> None:
    for state in (sv.INIT, sv.READY, sv.RUN, sv.HOLD):
        for fault in range(1, len(sv.FAULT_NAMES)):
            assert step(state, True, fault, False, False) == sv.FAULT, (state, fault)
            assert step(state, True, fault, True, False) == sv.STOP, (state, fault)


def test_only_fresh_input_closes_the_loop_in_two_steps() -> None:
    ways = {
        sv.STATE_NAMES[a]: sv.STATE_NAMES[step(a, True, 0, False, False)]
        for a in (sv.INIT, sv.READY, sv.HOLD)
    }
    assert ways == {"INIT": "READY", "READY": "RUN", "HOLD": "RUN"}, ways
    for state in (sv.INIT, sv.READY):
        assert step(state, False, 0, False, False) == state, sv.STATE_NAMES[state]


def test_the_heartbeat_says_operational_exactly_where_the_loop_is_closed() -> None:
    said = dict(zip(sv.STATE_NAMES, sv.NMT.tolist(), strict=True))
    expected = {"INIT": 127, "READY": 127, "RUN": 5, "HOLD": 5, "FAULT": 4, "STOP": 4}
    assert said == expected, said


def test_every_fault_has_a_name() -> None:
    codes = (
        sv.NO_FAULT,
        sv.INPUT_MISSING,
        sv.COMMAND_NOT_FINITE,
        sv.PEER_SILENT,
        sv.BUS_FAILED,
        sv.OVERRUN,
        sv.ANOTHER_SENDER,
        sv.REPEATED_INPUT,
        sv.OUTPUT_NOT_FINITE,
        sv.PLANT_NOT_FINITE,
        sv.STEP_RAISED,
        sv.STEP_HANGS,
    )
    assert codes == tuple(range(len(sv.FAULT_NAMES))), codes
