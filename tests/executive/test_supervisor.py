"""The supervisor: its table is the documented one, FAULT is latched, STOP is final."""

import re
from itertools import product

import numpy as np
import pytest
from engine import ROOT, SLEW10

from pcpc.executive.loop import strangers
from pcpc.executive.loop import supervisor as sv
from pcpc.executive.nodes.install import PATIENCE_S
from pcpc.executive.nodes.watched import HANG_PERIODS, HANG_S
from pcpc.executive.rig.reading import load_rig

EVENTS = ("NONE", "FRESH", "MISSED", "LOSS", "STOP_REQUEST", "RAMPED", "RESET", "DISARMED")


def documented_table() -> dict[tuple[str, str], str]:
    """Return {(state, event): next state} as the module's docstring says."""
    lines = [line.split() for line in (sv.__doc__ or "").splitlines()]
    head = next(i for i, words in enumerate(lines) if tuple(words) == EVENTS)
    rows = lines[head + 1 : head + 1 + len(sv.STATE_NAMES)]
    return {(row[0], event): to for row in rows for event, to in zip(EVENTS, row[1:], strict=True)}


def step(
    state: int, fresh: bool, fault: int, stopping: bool, ramped: bool, disarmed: bool = False
) -> int:
    """Return the next state as a plain number."""
    return int(sv.advance(state, fresh, fault, stopping, ramped, disarmed))


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


def test_FAULT_is_latched_until_the_ramp_is_over_or_a_reset_was_granted() -> None:
    for fresh, fault, stopping, ramped in ALL_INPUTS:
        to = step(sv.FAULT, fresh, fault, stopping, ramped)
        expected = sv.STOP if stopping or ramped else sv.FAULT
        expected = sv.INIT if fault == sv.NO_FAULT and not stopping else expected
        assert to == expected, f"{fresh=} {fault=} {stopping=} {ramped=}: {sv.STATE_NAMES[to]}"


def test_no_sequence_of_events_but_a_reset_leads_from_FAULT_back_to_the_closed_loop() -> None:
    reached, new = set(), {sv.FAULT}
    while new:
        reached |= new
        new = {int(to) for state in new for to in np.delete(sv.NEXT[state], sv.RESET)} - reached
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


def test_who_is_disarmed_is_ready_at_most_and_everything_else_goes_before() -> None:
    for fresh, fault, stopping, ramped in ALL_INPUTS:
        for state in (sv.READY, sv.RUN, sv.HOLD):
            to = step(state, fresh, fault, stopping, ramped, True)
            wanted = sv.STOP if stopping else sv.FAULT if fault else sv.READY
            assert to == wanted, f"{state} {fresh=} {fault=} {stopping=}: {sv.STATE_NAMES[to]}"
        for state in (sv.INIT, sv.FAULT, sv.STOP):
            inputs = state, fresh, fault, stopping, ramped
            assert step(*inputs, True) == step(*inputs, False), inputs


def test_the_heartbeat_says_operational_exactly_where_the_loop_is_closed() -> None:
    said = dict(zip(sv.STATE_NAMES, sv.NMT.tolist(), strict=True))
    expected = {"INIT": 127, "READY": 127, "RUN": 5, "HOLD": 5, "FAULT": 4, "STOP": 4}
    assert said == expected, said


def test_what_a_state_does_is_documented() -> None:
    lines = (sv.__doc__ or "").splitlines()
    head = next(i for i, line in enumerate(lines) if line.split()[:2] == ["state", "runs"])
    told = [re.split(r"\s{2,}", line.strip()) for line in lines[head + 1 : head + 7]]
    nmt = {127.0: "pre-operational", 5.0: "operational", 4.0: "stopped"}
    columns = zip(sv.STATE_NAMES, sv.DOES, sv.NMT, strict=True)
    expected = [
        [name, *(str(int(one)) for one in does), nmt[float(beat)]] for name, does, beat in columns
    ]
    assert told == expected


def test_the_page_tells_every_named_fault_with_its_limit_and_reaction() -> None:
    page = (ROOT / "docs/bus-safety.md").read_text(encoding="utf-8")
    told = re.findall(r"^\| (\d+) \| (.*?) \| (.*?) \| (.*?) \| `(.*?)` \|$", page, re.MULTILINE)
    expected = []
    for code, fault in enumerate(sv.FAULTS[1:], 1):
        cycles = "1 cycle" if fault.within == 1 else f"{fault.within} cycles"
        limit = f"`{fault.within}`" if isinstance(fault.within, str) else cycles
        words = [] if fault.within is None else [limit]
        limit = "; ".join([*words, *filter(None, [fault.why])])
        expected.append((str(code), fault.says, limit, fault.reaction, f"0x{fault.code:04X}"))
    assert told == expected


def test_the_limit_of_a_fault_is_a_key_of_the_rig_or_a_number_of_the_loop() -> None:
    config = load_rig(SLEW10).config
    for fault in sv.FAULTS[1:]:
        if isinstance(fault.within, str):
            section, _, key = fault.within.partition(".")
            assert hasattr(getattr(config, section), key), fault
        assert fault.within is not None or fault.why, fault
    foreign, repeated = sv.FAULTS[sv.ANOTHER_SENDER], sv.FAULTS[sv.REPEATED_INPUT]
    counts = strangers.FOREIGN_FRAMES, strangers.REPEATED_FRAMES
    assert (foreign.within, repeated.within) == counts
    assert foreign.why == f"{counts[0]} frames in {strangers.FOREIGN_CYCLES} cycles"
    assert repeated.why == f"{counts[1]} frames in {strangers.REPEATED_CYCLES} cycles"
    silent, hangs = sv.FAULTS[sv.PEER_SILENT], sv.FAULTS[sv.STEP_HANGS]
    assert f"after {PATIENCE_S:g} s" in silent.why
    assert hangs.why == f"after {HANG_S:g} s or {HANG_PERIODS:g} periods"


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
        sv.EMERGENCY_STOP,
        sv.STOP_FRAME,
        sv.NOT_PLAUSIBLE,
        sv.INTRUSION,
        sv.BUS_OFF,
    )
    assert codes == tuple(range(len(sv.FAULT_NAMES))), codes
