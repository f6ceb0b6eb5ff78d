"""Another sender of our frames: on the wire, in the loop, in the host's words, in a replay."""

import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from engine import ATB1000, Bench, Node, both
from free_bus import own_bus
from wires import new_wire

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import e2e, wire
from pcpc.drivers.can.bus import BusAddress
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.can.wire_layout import Arrival
from pcpc.executive.loop import faults, strangers
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.reception import take_frame
from pcpc.executive.loop.ring_layout import FRAME_WORDS
from pcpc.executive.rig.reading import load_rig

RIG = load_rig(ATB1000 / "rigs" / "slew10.yaml")
CMD, SYNC, FB_A = 0x0A0, 0x080, 0x120
TRUE, FORGED = 7, 9  # addresses


@pytest.fixture
def node() -> Node:
    """Return an executive after its first cycles with a plant in memory."""
    bench = Bench(both(RIG))
    assert bench.run(20) == 20
    bench.executive.plant = bench.plant
    return bench.executive


def hear(node: Node, can_id: int, source: int = 0, counter: int | None = None) -> int:
    """Give the node a frame that is right but for its sender; return its row, -1 if not taken."""
    n = node.loop
    n.wire.rx[:] = 0
    n.wire.rx[:4] = np.frombuffer(can_id.to_bytes(4, "little"), np.uint8)
    rows = [i for i in range(n.rx.n) if n.rx.frames[i].can_id == can_id]
    if rows:
        n.wire.rx[4] = n.rx.frames[rows[0]].dlc
        after = int(n.rx.state[rows[0]].last_counter) + 1 if counter is None else counter
        e2e.protect(n.wire.rx[8:16], rows[0], n.rx.frames, after)
    n.wire.source = source
    return int(take_frame(n))


def cycles(node: Node, count: int) -> None:
    """Let time pass for the receiver, as `count` cycles do."""
    for _ in range(count):
        e2e.begin_cycle(node.loop.rx.state, node.loop.rx.n)
        node.loop.passes += 1


# The wire


@pytest.fixture
def open_udp() -> Iterator[Callable[[], Any]]:
    ends, bus = [], BusAddress(*buses.parse(own_bus()))  # type: ignore[arg-type]

    def opener() -> Any:
        ends.append(new_wire())
        buses.open_bus(bus, [], ends[-1])
        return ends[-1]

    yield opener
    for end in ends:
        os.close(end.fd_tx)
        os.close(end.fd_rx)


def test_on_udp_an_end_knows_its_own_frames_and_tells_senders_apart(
    open_udp: Callable[[], Any],
) -> None:
    a, b, c = open_udp(), open_udp(), open_udp()
    buses.set_own_address(a)
    for sender in (a, b, c, b):
        sender.tx[:] = 0
        assert wire.put_frame(sender)
    results, sources = [], []
    for _ in range(4):
        results.append(wire.get_frame(a, True))
        sources.append(int(a.source))
    assert results == [
        Arrival.OWN,
        Arrival.FRAME,
        Arrival.FRAME,
        Arrival.FRAME,
    ], f"{results}"
    assert len(set(sources)) == 3 and sources[1] == sources[3] and 0 not in sources, f"{sources}"
    assert wire.get_frame(b, True) == Arrival.FRAME, "who does not know its own hears itself"


# The loop


def test_one_frame_of_our_own_id_is_counted_named_and_recorded(node: Node) -> None:
    assert hear(node, SYNC) == -1
    assert (node.count("foreign"), int(node.loop.guard.faulted)) == (1, Fault.NONE)
    assert [event[1] for event in node.events(Event.FOREIGN)] == [SYNC]
    last = node.loop.frame.reshape(-1, FRAME_WORDS)[int(node.loop.frame_ends.head) - 1]
    assert (last[3] & 0xFFF, last[3] >> 48) == (SYNC, FrameState.FOREIGN)


def test_three_within_ten_cycles_are_a_fault_that_names_the_id(node: Node) -> None:
    for wait in (0, 4, 5):
        assert int(node.loop.guard.faulted) == Fault.NONE
        cycles(node, wait)
        hear(node, CMD)
    assert int(node.loop.guard.faulted) == Fault.ANOTHER_SENDER
    control = node.loop.control.copy()
    control.fault = node.loop.guard.faulted
    told = faults.reason({"frames": {str(CMD): "CMD"}}, control)
    assert told == "another sender of 0x0A0 (CMD) is on this bus"


def test_two_now_and_then_are_no_fault_but_count(node: Node) -> None:
    for _ in range(10):
        hear(node, CMD)
        hear(node, CMD)
        cycles(node, strangers.FOREIGN_CYCLES)
    assert (node.count("foreign"), int(node.loop.guard.faulted)) == (20, Fault.NONE)


def test_ids_of_nobody_are_no_concern(node: Node) -> None:
    for can_id in range(0x7FF):
        if can_id not in node.frames.values():
            assert hear(node, can_id) == -1
    assert (node.count("foreign"), int(node.loop.guard.faulted)) == (0, Fault.NONE)


def test_a_frame_from_another_address_is_not_taken(node: Node) -> None:
    assert hear(node, FB_A, TRUE) >= 0
    received = node.count("received")
    assert hear(node, FB_A, FORGED) == -1
    assert (node.count("foreign"), node.count("received")) == (1, received)
    assert hear(node, FB_A, TRUE) >= 0 and node.count("received") == received + 1


def test_a_sender_that_fell_silent_may_be_replaced(node: Node) -> None:
    hear(node, FB_A, TRUE)
    cycles(node, strangers.SILENT_TURNS)
    assert hear(node, FB_A, FORGED) == -1
    cycles(node, 1)
    assert hear(node, FB_A, FORGED) >= 0
    assert hear(node, FB_A, TRUE) == -1 and node.count("foreign") == 2


def test_the_true_frames_behind_forged_ones_are_a_fault_also_without_addresses(node: Node) -> None:
    needed = 0
    while int(node.loop.guard.faulted) == Fault.NONE:
        hear(node, FB_A)  # forged, with the next counter
        hear(node, FB_A, counter=int(node.loop.rx.state[0].last_counter))  # the true one
        cycles(node, 1)
        needed += 1
        assert needed <= strangers.REPEATED_CYCLES
    assert (
        int(node.loop.guard.faulted) == Fault.REPEATED_INPUT and needed == strangers.REPEATED_FRAMES
    )
    assert node.count("repeated") == needed and int(node.loop.control.culprit) == FB_A


def test_forged_counters_are_a_wrong_sequence_not_thousands_of_losses(node: Node) -> None:
    for _ in range(1000):
        hear(node, FB_A, counter=int(node.loop.rx.state[0].last_counter) + 9)
    assert node.count("wrong_sequence") == 1000
    assert node.count("lost") == 0, node.count("lost")


def test_before_its_first_cycle_a_node_does_not_begin_beside_another(node: Node) -> None:
    node.loop.passes = 0
    hear(node, SYNC)
    assert int(node.loop.guard.faulted) == Fault.ANOTHER_SENDER and strangers.refused(node.loop)
