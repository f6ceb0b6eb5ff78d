"""Two senders of one frame: recognised, told apart from a bad bus, answered as the rig chose."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine import ATB1000, Bench, Node, both
from replays import replayed

from pcpc.drivers.can import e2e
from pcpc.executive.log import reader as logs
from pcpc.executive.loop import faults
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.injected_frames import excused
from pcpc.executive.loop.intrusion import HINT_TURNS, REACTIONS
from pcpc.executive.loop.reception import take_frame
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.virtual import in_memory, simulate
from pcpc.executive.rig.reading import Rig, load_rig

HULL = ATB1000 / "rigs/hull.yaml"
FB_A, HB_PLANT = 0x120, 0x702
TWO, AHEAD, PLACES = Event.TWO_SENDERS, Event.AHEAD, Event.TWO_PLACES


def rig_with(intrusion: str, more: str = "") -> Rig:
    """Return the barrel on its hull with a reaction to intrusion."""
    text = f"base: {HULL}\nrig: watched\nduration_s: 0.4\nevaluation: null\nrequire: []\n"
    text += f"expect: {{}}\nsupervisor: {{intrusion: {intrusion}}}\n{more}"
    return load_rig(HULL.with_name("watched.yaml"), text=text)


def fault(kind: str, frame: str = "CMD", cycles: int = 40) -> str:
    """Return the rig's entry of a fault of a frame that acts from cycle 100 on."""
    return f"faults: {{it: {{kind: {kind}, frame: {frame}, from: 100ms, for: {cycles}ms}}}}\n"


@pytest.fixture(params=REACTIONS)
def node(request: pytest.FixtureRequest) -> Node:
    """Return an executive with each reaction, after its first cycles with a plant in memory."""
    bench = Bench(both(rig_with(request.param)))
    assert bench.run(20) == 20
    return bench.executive


def hear(node: Node, ahead: int = 1, byte: int = 0, wrong_crc: bool = False) -> None:
    """Give the node a frame whose counter is `ahead` of the last one, with data `byte`."""
    n = node.loop
    n.wire.rx[:] = 0
    n.wire.rx[:2] = FB_A & 0xFF, FB_A >> 8
    n.wire.rx[8:12] = byte
    n.wire.rx[4] = n.rx.frames[0].dlc
    assert n.rx.frames[0].can_id == FB_A
    counter = int(n.rx.state[0].last_counter) + ahead
    e2e.protect(n.wire.rx[8:16], 0, n.rx.frames, counter)
    n.wire.rx[15] ^= wrong_crc
    take_frame(n)


def turn(node: Node, count: int = 1) -> None:
    """Let time pass for the receiver, as `count` cycles do."""
    n = node.loop
    for _ in range(count):
        e2e.begin_cycle(n.rx.state, n.rx.n)
        n.rx.fresh = 0
        n.passes += 1
        n.k += 1


def signs(node: Node) -> list[int]:
    """Return how many events of each kind were told."""
    return [len(node.events(kind)) for kind in (TWO, AHEAD, PLACES)]


def received(node: Node) -> list[float]:
    """Return the values of the frame that `hear` gives."""
    n = node.loop
    first, past = n.rx.frames[0].first, n.rx.frames[0].end
    return [float(n.v[place]) for place in n.rx.signals["variable"][first:past]]


def test_a_frame_with_a_wrong_crc_is_not_decoded_and_no_input(node: Node) -> None:
    turn(node)
    before, used = received(node), int(node.loop.control.received)
    hear(node, 1, 200, wrong_crc=True)
    assert received(node) == before and node.loop.rx.fresh == 0
    assert node.loop.control.received == used
    hear(node, 1, 3)  # the same but for its CRC is input
    assert received(node) != before and node.loop.control.received == used + 1


def before_the_true_one(node: Node) -> None:
    hear(node, 1, 200)
    hear(node, 0, 3)


def two_ahead_of_the_true_one(node: Node) -> None:
    hear(node, 2, 200)
    hear(node, -1, 3)


def far_ahead(node: Node) -> None:
    hear(node, 6, 200)
    hear(node, -5, 3)


def with_a_wrong_crc(node: Node) -> None:
    hear(node, 1, 3)
    hear(node, 1, 200, wrong_crc=True)


ATTACKS = [(before_the_true_one, 1), (two_ahead_of_the_true_one, 3), (far_ahead, 1),
           (with_a_wrong_crc, 3)]  # fmt: skip


@pytest.mark.parametrize(
    ("attack", "cycles"), ATTACKS, ids=lambda one: getattr(one, "__name__", "")
)
def test_an_attack_each_cycle_ends_in_the_chosen_reaction_within_3_cycles(
    attack: Callable[[Node], None], cycles: int, node: Node
) -> None:
    reaction = REACTIONS[node.loop.intrusion.reaction]
    for cycle in range(1, 6):
        turn(node)
        attack(node)
        assert node.count("intrusions") >= cycle
        believed = cycle >= cycles and reaction != "count"
        if believed:
            assert node.loop.rx.fresh == 0, "no input in this cycle"
        wanted = Fault.INTRUSION if believed and reaction == "fault" else Fault.NONE
        assert node.loop.guard.faulted == wanted, (cycle, reaction)
    assert sum(signs(node)) >= 1
    if reaction == "fault":
        control = node.loop.control.copy()
        control.fault = node.loop.guard.faulted
        told = faults.reason({"frames": {str(FB_A): "FB_A"}}, control)
        assert told == "0x120 (FB_A) comes from two senders"


def test_what_a_forged_frame_said_is_taken_back_in_its_cycle(node: Node) -> None:
    hear(node, 1, 3)
    true = node["rx.FB_A.encoder"]
    turn(node)
    hear(node, 1, 200)
    assert node["rx.FB_A.encoder"] != true
    hear(node, 0, 3)
    believed = node.loop.intrusion.reaction > 0
    assert (node["rx.FB_A.encoder"] == true) == believed
    hear(node, 1, 77)  # and it goes on in the same cycle
    assert (node["rx.FB_A.encoder"] == true) == believed
    assert node.loop.rx.fresh == (0 if believed else 1)
    turn(node)
    hear(node, 1, 5)
    assert node["rx.FB_A.encoder"] != true and node.loop.rx.fresh == 1, "another cycle, another try"


def test_what_was_taken_back_is_no_reference_of_a_rate_limit() -> None:
    rate = "executive: {plausible: {FB_A.encoder: {rate_per_s: 1.0e9}}}\n"
    bench = Bench(both(rig_with("hold", rate)))
    assert bench.run(20) == 20
    node, taken = bench.executive, bench.executive.loop.plausible.taken
    hear(node, 1, 3)
    true = float(taken[0])
    assert true == node["rx.FB_A.encoder"]
    turn(node)
    hear(node, 1, 200)
    assert taken[0] == node["rx.FB_A.encoder"] != true
    hear(node, 0, 3)
    assert taken[0] == true


def test_a_fault_on_purpose_excuses_what_follows_for_20_cycles_and_no_more(node: Node) -> None:
    n = node.loop
    assert not excused(n, 0)
    for age, wanted in ((0, True), (20, True), (21, False), (1000, False)):
        n.passes = 2000
        n.faults.acted[0] = n.passes + 1 - age
        assert bool(excused(n, 0)) == wanted, age


def a_frame_twice(node: Node) -> None:
    hear(node, 1, 3)
    hear(node, 0, 3)


def three_lost(node: Node) -> None:
    turn(node, 3)
    hear(node, 4, 9)


def a_long_loss(node: Node) -> None:
    turn(node, 8)
    hear(node, 9, 9)


def a_whole_turn_lost(node: Node) -> None:
    turn(node, 15)
    hear(node, 16, 9)


def late_and_then_all(node: Node) -> None:
    turn(node, 9)
    for i in range(10):
        hear(node, 1, i)


def damaged(node: Node) -> None:
    hear(node, 1, 3, wrong_crc=True)


def repeated_after_a_jump(node: Node) -> None:
    turn(node, 6)
    hear(node, 7, 9)
    hear(node, 0, 9)


def after_a_stall(node: Node) -> None:
    node.loop.clock.behind = 20
    node.loop.k += 20
    hear(node, 7, 9)
    node.loop.clock.behind = 0


BAD_BUS = [a_frame_twice, three_lost, a_long_loss, a_whole_turn_lost, late_and_then_all, damaged,
           repeated_after_a_jump, after_a_stall]  # fmt: skip


@pytest.mark.parametrize("event", BAD_BUS)
def test_what_a_bad_bus_does_is_no_intrusion(event: Callable[[Node], None], node: Node) -> None:
    for _ in range(5):
        turn(node)
        event(node)
    assert node.count("intrusions") == 0 and signs(node) == [0, 0, 0]
    assert node.loop.guard.faulted == Fault.NONE


def test_a_single_swap_is_a_hint_and_no_more(node: Node) -> None:
    for _ in range(4):
        hear(node, 2, 3)
        hear(node, -1, 4)
        turn(node, HINT_TURNS)
    assert node.count("intrusions") == 4 and node.loop.guard.faulted == Fault.NONE


def beat(node: Node, every: int, of: int) -> None:
    """Hear a heartbeat `every` so many of the cycles of its turn, `of` times."""
    n = node.loop
    (row,) = [i for i in range(n.rx.n) if n.rx.frames[i].can_id == HB_PLANT]
    for _ in range(of):
        turn(node, every)
        n.wire.rx[:] = 0
        n.wire.rx[:2], n.wire.rx[4], n.wire.rx[8] = (HB_PLANT & 0xFF, HB_PLANT >> 8), 1, 5
        assert n.rx.frames[row].dlc == 1 and take_frame(n) == row


def test_a_heartbeat_from_two_places_is_told(node: Node) -> None:
    turns = int(node.loop.intrusion.beat_every.max())
    assert turns == 100
    beat(node, turns, 5)
    beat(node, 80, 5)
    beat(node, 20, 1)
    beat(node, turns, 20)
    assert signs(node) == [0, 0, 0], "one that came early now and then is nobody else's"
    for _ in range(5):
        beat(node, 30, 1)
        beat(node, 70, 1)
    assert signs(node)[2] > 0 and node.count("intrusions") == 9
    wanted = Fault.INTRUSION if node.loop.intrusion.reaction == 2 else Fault.NONE
    assert node.loop.guard.faulted == wanted


# In virtual time


def plant_after(rig: Rig) -> Any:
    return in_memory(rig).node["plant"].columns


def test_forged_commands_are_a_fault_in_their_first_cycle_and_never_act() -> None:
    columns = plant_after(rig_with("fault", fault("forgery")))
    assert np.flatnonzero(columns["supervisor.fault"])[0] <= 101
    assert columns["supervisor.fault"].max() == Fault.INTRUSION
    assert abs(columns["rx.CMD.motor_torque"]).max() < 0.5, "drawn torques are up to 30 N m"


def test_with_hold_forged_commands_are_missing_input() -> None:
    columns = plant_after(rig_with("hold", fault("forgery")))
    states = columns["supervisor.state"]
    assert set(states[98:100]) == {2.0} and State.FAULT in states[100:106]
    assert columns["supervisor.fault"].max() == Fault.INPUT_MISSING
    assert abs(columns["rx.CMD.motor_torque"]).max() < 0.5


def test_with_count_they_act_as_ever_and_one_that_says_STOP_ends_the_plant() -> None:
    columns = plant_after(rig_with("count", fault("forgery")))
    assert columns["supervisor.fault"].max() == Fault.NONE and len(columns["time.t_s"]) < 150
    assert abs(columns["rx.CMD.motor_torque"]).max() > 1.0


@pytest.mark.parametrize(
    ("kind", "cycles", "noticed"),
    [
        ("forgery", 1, True), ("insertion", 3, True), ("masquerade", 1, False),
        ("counter, how: offset, value: 6", 5, True), ("loss", 2, False), ("corruption", 2, False),
        ("repetition", 5, True), ("length, value: 3", 2, False), ("payload, how: freeze", 9, False),
    ],
)  # fmt: skip
def test_which_injected_faults_are_an_intrusion(kind: str, cycles: int, noticed: bool) -> None:
    log = in_memory(rig_with("count", fault(kind, "FB_A", cycles)))
    last = log.node["executive"].timing["health.intrusions"][-1]
    assert (last > 0) == noticed, last


def test_a_clean_run_and_one_with_losses_have_no_sign_of_it() -> None:
    rig = rig_with("fault", "losses: {FB_A: {share: 0.2}, CMD: {share: 0.1, burst: 2}}\n")
    log = in_memory(
        load_rig(
            rig.path,
            None,
            ["duration_s=3", "supervisor.fault_after_cycles=99"],
            text=rig.document.sources[rig.path],
        )
    )
    for node in log.node.values():
        assert node.timing["health.intrusions"][-1] == 0
        assert node.columns["supervisor.fault"].max() == 0


def test_the_run_is_told_and_replayed_to_the_bit(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    simulate(rig_with("fault", fault("forgery")), path)
    told = [e for e in logs.read(path).node["plant"].events if e["event"] == "two senders"]
    assert [(e["name"], e["argument"]) for e in told] == [("CMD", 0xA0)]
    seen = replayed(path)
    assert len(seen) == 2 and all(one.identical for one in seen), seen


def test_one_forged_behind_each_true_frame_is_known_a_cycle_later(node: Node) -> None:
    hear(node, 1, 3)
    hear(node, 1, 200)  # what the sender will say in the next cycle, as the counter has it
    assert node.count("intrusions") == 0
    turn(node)
    hear(node, 0, 3)
    assert node.count("intrusions") == 1
    hear(node, 1, 200)
    reaction = node.loop.intrusion.reaction
    assert (node.loop.rx.fresh == 0) == (reaction > 0)
    assert node.loop.guard.faulted == (Fault.INTRUSION if reaction == 2 else Fault.NONE)
