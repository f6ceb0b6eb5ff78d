"""Tunings through the mailbox: all of a request in one cycle or none, only what may be tuned."""

import math
from pathlib import Path

import numpy as np
import pytest
from engine import Bench, both, puppet_rig

from pcpc.drivers.compiled.structures import words_of
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.requests import SLOTS, Refusal
from pcpc.executive.loop.states import State
from pcpc.executive.rig.reading import load_rig

RUN = State.RUN


def test_tunings_of_one_request_take_effect_in_one_cycle(bench: Bench) -> None:
    node = bench.executive
    node.post({"controller.torque_Nm": 1.25, "controller.other_Nm": 40.0})
    bench.run(5)
    torque, other = node.series("controller.motor_torque_Nm"), node.series("controller.tau_Nm")
    changed = [int(np.flatnonzero(np.diff(s))[-1]) + 1 for s in (torque, other)]
    assert changed == [10, 10], changed
    assert (torque[9], torque[10], other[9], other[10]) == (1.0, 1.25, 0.0, 40.0)
    assert node.loop.answer.tolist()[:3] == (1, 10, Refusal.ACCEPTED), node.loop.answer
    places = [node.place(f"controller.{name}_Nm") for name in ("torque", "other")]
    assert node.events(Event.TUNING) == [(10, places[0], 1.25), (10, places[1], 40.0)]


def test_values_in_the_mailbox_wait_for_the_request(bench: Bench) -> None:
    node = bench.executive
    node.post({"controller.torque_Nm": 1.25})
    node.loop.mail.request -= 1
    bench.run(3)
    assert node["controller.torque_Nm"] == 1.0 and not node.events(Event.TUNING)
    node.loop.mail.request += 1
    bench.run(3)
    assert node["controller.torque_Nm"] == 1.25
    assert int(node.loop.answer.cycle) == 13, node.loop.answer


def test_a_request_is_carried_out_once(bench: Bench) -> None:
    node = bench.executive
    node.post({"controller.torque_Nm": 1.25})
    bench.run(1)
    node["controller.torque_Nm"] = 0.5
    bench.run(5)
    assert node["controller.torque_Nm"] == 0.5 and len(node.events(Event.TUNING)) == 1


GAIN, OTHER = "controller.torque_Nm", "controller.other_Nm"  # both -1e9 to 1e9
BEYOND = (-1, -(2**63), 2**63 - 1, sh.MAX_VARIABLES, 10**12)


def refused(bench: Bench, places: list[int], values: list[float], **words: int) -> int:
    """Post a request as any client may; check that nothing came of it; return the reason."""
    node = bench.executive
    n, before, told = node.loop, node.loop.v.copy(), len(node.events(Event.REFUSED))
    n.mail_index[: len(places)], n.mail_value[: len(values)] = places, values
    n.mail.count, n.mail.lock = words.get("count", len(places)), words.get("lock", 0)
    n.mail.request += 1
    bench.run(1)
    assert int(n.answer.request) == int(n.mail.request), "no answer"
    parameters = [node.place(v.name) for v in node.plan.table.variables if v.kind == "parameter"]
    assert (n.v[parameters] == before[parameters]).all(), "something was set"
    assert (n.v[int(n.n_variables) :] == 0.0).all(), "written outside of the table"
    assert not node.events(Event.TUNING) and node.state == "RUN", node.state
    assert len(node.events(Event.REFUSED)) == told + 1, node.events(Event.REFUSED)
    assert node.count("refused") == told + 1 == node["health.requests_refused"]
    return int(n.answer.refusal)


def test_only_parameters_are_taken_from_the_mailbox(bench: Bench) -> None:
    node = bench.executive
    gain = node.place(GAIN)
    others = [node.place(v.name) for v in node.plan.table.variables if v.kind != "parameter"]
    assert len(others) > 50, len(others)
    for place in (*others, int(node.loop.n_variables), *BEYOND):
        assert refused(bench, [gain, place], [0.5, 4.0]) == Refusal.NO_PARAMETER, place
        assert int(node.loop.answer.entry) == 1, node.loop.answer


JUST_ABOVE, JUST_BELOW = math.nextafter(1e9, math.inf), math.nextafter(-1e9, -math.inf)


@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, 1e300, -1.1e9, 5e300, JUST_ABOVE, JUST_BELOW]
)
def test_a_value_outside_of_its_range_is_refused_with_all_that_came_with_it(
    bench: Bench, value: float
) -> None:
    node = bench.executive
    places = [node.place(GAIN), node.place(OTHER)]
    assert refused(bench, places, [0.5, value]) == Refusal.OUT_OF_RANGE
    node.post({GAIN: 1e9, OTHER: -1e9})
    bench.run(1)
    assert (node[GAIN], node[OTHER]) == (1e9, -1e9), "the edges are inside"


def test_the_loop_has_the_range_of_each_parameter_and_none_of_what_is_no_parameter(
    bench: Bench,
) -> None:
    for node in (bench.executive, bench.plant):
        for j, v in enumerate(node.plan.table.variables):
            found = float(node.loop.tuning.low[j]), float(node.loop.tuning.high[j])
            if v.kind == "parameter":
                assert found == (v.low, v.high), v
            else:
                assert math.isnan(found[0]) and math.isnan(found[1]), v


def test_a_request_of_the_supervisor_has_an_upper_end(bench: Bench) -> None:
    for name, high in (("supervisor.stop", 2.0), ("supervisor.disarmed", 1.0)):
        assert refused(bench, [bench.executive.place(name)], [high + 1]) == Refusal.OUT_OF_RANGE, (
            name
        )


def test_an_unbounded_parameter_takes_no_infinity(bench: Bench) -> None:
    node = bench.executive
    node.loop.tuning.high[node.place(GAIN)] = math.inf
    assert refused(bench, [node.place(GAIN)], [math.inf]) == Refusal.OUT_OF_RANGE


@pytest.mark.parametrize("count", [-1, SLOTS + 1, 10**6, -(2**63), 2**63 - 1])
def test_a_count_that_no_mailbox_has_is_refused(bench: Bench, count: int) -> None:
    assert refused(bench, [bench.executive.place(GAIN)], [0.5], count=count) == Refusal.BAD_COUNT


@pytest.mark.parametrize("level", [1, 2, -1, 2**62])
def test_the_loop_itself_keeps_to_the_lock(bench: Bench, level: int) -> None:
    assert refused(bench, [bench.executive.place(GAIN)], [0.5], lock=level) == Refusal.LOCKED


def test_a_stop_that_the_lock_lets_pass_takes_no_tuning_with_it(bench: Bench) -> None:
    node = bench.executive
    stop, gain = node.place("supervisor.stop"), node.place(GAIN)
    for places in ([stop, gain], [gain, stop]):
        assert refused(bench, places, [1.0, 1.0], lock=1) == Refusal.LOCKED, places
    node.post({"supervisor.stop": 1.0})
    bench.run(1)
    assert node.loop.mail.lock == 1 and node.loop.answer.refusal == Refusal.ACCEPTED
    assert node.loop.guard.stop == 1


def test_a_request_that_was_withdrawn_sets_nothing_and_is_no_refusal(bench: Bench) -> None:
    node = bench.executive
    node.post({GAIN: 0.5})
    node.loop.mail.count = 0
    bench.run(1)
    assert node.loop.answer.request == 1 and node.loop.answer.refusal == Refusal.ACCEPTED
    assert node[GAIN] == 1.0 and node.count("refused") == 0


def test_garbage_in_the_mailbox_changes_neither_outputs_nor_private_memory(
    tmp_path: Path,
) -> None:
    """The fixture's rig twice: alone, and with random bytes in all that clients write."""
    plans, random = both(load_rig(puppet_rig(tmp_path))), np.random.default_rng(26)
    quiet, noisy = Bench(plans), Bench(plans)
    n = noisy.executive.loop
    mailbox = [words_of(n[name]).view(np.uint8) for name in sh.MAILBOX_FIELDS]
    for i in range(500):
        for words in mailbox:
            words[:] = random.integers(0, 256, len(words), np.uint8)
        n.mail_index[::2] = random.integers(0, int(n.n_variables), 32)
        n.mail_index[0] = noisy.executive.place("supervisor.state")
        n.mail.count = (i % 66) if i % 3 else random.integers(-(2**63), 2**63)
        n.mail.lock = i % 2
        assert quiet.run(1) == noisy.run(1) == 1, f"round {i}"
        n.record_taken[0] = n.frame_taken[0] = n.event_taken[0] = 0
    ours, theirs = quiet.executive, noisy.executive
    names = ("v", "limits", "blocks", "rx", "tx")
    counted = [theirs.place("health.requests_refused")]
    theirs.loop.v[counted] = 0.0
    different = [x for x in names if ours.loop[x].tobytes() != theirs.loop[x].tobytes()]
    assert not different, different
    assert theirs.count("refused") > 300, theirs.count("refused")
