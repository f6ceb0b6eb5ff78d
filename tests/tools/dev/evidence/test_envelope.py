"""No law takes a command out of its envelope; and what is out of it is told."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcpc.drivers.compiled.jit import LOOP_INTERPRETED
from pcpc.executive.loop.states import STATE_NAMES
from pcpc.tools.dev.evidence import cli, envelope, report
from pcpc.tools.dev.evidence.envelope import CYCLES, LOW, ODD, RATE, REQUESTS, SAFE, Law

ANSWERS = st.floats(width=64) | st.sampled_from(ODD) | st.floats(-3.0, 3.0)
CYCLE = st.integers(1, CYCLES)


@st.composite
def laws(draw: st.DrawFn) -> Law:
    """Draw a law, faults and requests; few answers in turn, or as many as it can have."""
    turn = draw(
        st.lists(ANSWERS, min_size=1, max_size=8) | st.lists(ANSWERS, min_size=64, max_size=64)
    )
    answers = np.resize(turn, envelope.COUNT).tolist()
    events = []
    for _ in range(draw(st.integers(0, 6))):
        if draw(st.booleans()):
            name = draw(st.sampled_from([*REQUESTS]))
            events.append((draw(CYCLE), name, draw(st.sampled_from(REQUESTS[name]))))
        else:
            name = draw(st.sampled_from(envelope.faults()))
            events.append((draw(CYCLE), f"fault.{name}.left", float(draw(st.integers(1, 40)))))
    return Law(answers, draw(ANSWERS), events, draw(st.integers(0, 2**31)))


@given(laws())
@settings(max_examples=20 if LOOP_INTERPRETED else 300, derandomize=True, deadline=None)
def test_no_law_takes_a_command_out_of_its_envelope(law: Law) -> None:
    assert envelope.run(law) == []


def test_drawn_laws_meet_every_state_and_are_counted() -> None:
    found = envelope.runs_of((1, 101))
    assert found["runs"] == 100 and found["broken"] == {} and min(found["met"]) > 5, found


@pytest.mark.parametrize(("sent", "state", "told"), [
    ([SAFE, SAFE + RATE, SAFE], [0, 2, 3], []),
    ([SAFE, SAFE + RATE, np.nan], [0, 2, 2], ["range"]),
    ([LOW - RATE, LOW], [2, 2], ["range", "rate"]),
    ([SAFE, SAFE + 1.01 * RATE], [0, 2], ["rate"]),
    ([SAFE + RATE, SAFE], [0, 0], ["not safe in INIT"]),
    ([SAFE, SAFE, SAFE - RATE], [2, 4, 4], ["away from safe in FAULT"]),
])  # fmt: skip
def test_what_is_out_of_it_is_told(sent: list[float], state: list[int], told: list[str]) -> None:
    cycles = np.arange(len(sent))
    assert [*envelope.commands(cycles, np.array(state), np.array(sent))] == told
    assert STATE_NAMES[4] == "FAULT"


def test_a_limit_that_the_rig_has_not_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(envelope, "HIGH", 1.5)
    monkeypatch.setattr(envelope, "RATE", 0.1)
    found = envelope.runs_of((1, 21))
    told = {word for wrong in found["broken"].values() for word in wrong}
    assert {"range", "rate"} <= told, found
    kept = {"laws": 20, "kept": False, "met": {"RUN": 20}, "broken": found["broken"]}
    assert cli.failures({"envelope": kept})[0].startswith("beyond the envelope: ")
    assert f"{len(found['broken'])} of them sent" in "".join(report._parts({"envelope": kept}))
