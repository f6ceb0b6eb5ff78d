"""The gateway between two channels, pass by pass: a test moves its start, so no time is waited."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from free_bus import own_bus
from hypothesis import given
from hypothesis import strategies as st
from wires import new_wire

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import wire
from pcpc.drivers.can.wire_layout import Arrival, Flag
from pcpc.drivers.line import line
from pcpc.drivers.line.line import SenderState
from pcpc.drivers.line.ticks import ns_of, tick_at
from pcpc.executive.nodes.gateway import Gateway

S = 1_000_000_000
Make = Callable[..., tuple[Gateway, Any, Any]]


def an_end(bus: buses.BusAddress) -> Any:
    end = new_wire()
    buses.open_bus(bus, None, end)
    buses.set_own_address(end)
    return end


@pytest.fixture
def make() -> Iterator[Make]:
    """Make a gateway and an end of each of its sides."""
    opened: list[Any] = []

    def made(bitrate: int = 1_000_000, room: int = 64, **options: Any) -> tuple[Gateway, Any, Any]:
        first = buses.bus_named(*buses.parse(own_bus()))
        sides = [first, buses.neighbour_of(first)]
        gateway = Gateway(room, bitrate=bitrate, **options)
        gateway.open(sides)
        opened.extend([gateway.n.side[0], gateway.n.side[1], *map(an_end, sides)])
        return gateway, *opened[-2:]

    yield made
    for end in opened:
        os.close(end.fd_tx)
        os.close(end.fd_rx)


def send(end: Any, *ids: int) -> None:
    for can_id in ids:
        end.tx[:] = 0
        end.tx[:2] = list(can_id.to_bytes(2, "little"))
        assert wire.put_frame(end)


def there(end: Any) -> list[int]:
    """Return the ids of the frames of others that an end has."""
    found = []
    while (what := wire.get_frame(end, False)) != Arrival.NOTHING:
        if what == Arrival.FRAME:
            found.append(int.from_bytes(end.rx[:2].tobytes(), "little"))
    return found


def one_pass(gateway: Gateway, passed_ns: int = 0) -> None:
    """Do one pass, `passed_ns` later."""
    gateway.n.start_ns -= passed_ns
    gateway.n.control.stop = 1
    gateway.carry()


def test_frames_go_to_the_other_side_by_priority_once_their_bits_have_passed(make: Make) -> None:
    gateway, a, b = make(1000)  # 1 ms a bit: no pass of a test lasts a frame
    one_pass(gateway)
    send(a, 0x300, 0x100)
    send(b, 0x200)
    one_pass(gateway)
    assert there(b) == there(a) == [], "47 bits and more are still to pass"
    one_pass(gateway, S)
    assert (there(a), there(b)) == ([0x200], [0x100, 0x300])
    assert gateway.n.line.sent[:3].tolist() == [2, 1, 0]


def test_fd_frames_cross_a_line_of_two_bit_rates_and_no_other(make: Make) -> None:
    for rates in ({"fd": True, "data_bitrate": 4000}, {}):
        gateway, a, b = make(1000, **rates)
        one_pass(gateway)
        a.tx[:] = 0
        a.tx[0], a.tx[4], a.tx[5], a.tx[8:56] = 7, 48, Flag.FD | Flag.BRS, range(48)
        b.fd = 1
        assert wire.put_frame(a)
        one_pass(gateway)
        one_pass(gateway, S // 10)
        assert there(b) == [], "its data phase takes more than 0.1 s"
        one_pass(gateway, S // 5)
        assert there(b) == ([7] if rates else [])
        assert gateway.n.foreign[:2].tolist() == ([0, 0] if rates else [1, 0])
        if rates:
            assert b.rx.tobytes() == a.tx.tobytes()


def test_in_order_the_frames_of_a_side_keep_theirs(make: Make) -> None:
    gateway, a, b = make(1000, in_order=True)
    one_pass(gateway)
    send(a, 0x300, 0x100)
    one_pass(gateway)
    one_pass(gateway, S)
    assert there(b) == [0x300, 0x100]


def test_a_full_queue_and_a_bus_that_is_off_lose_frames_which_are_counted(make: Make) -> None:
    gateway, a, b = make(1000, room=2, p=1.0)
    one_pass(gateway)
    send(a, 1, 2, 3)
    one_pass(gateway)
    assert gateway.n.line.refused[0] == 1
    one_pass(gateway, S)  # 32 times 27 bits
    assert line.state_of(gateway.n.line, 0) == SenderState.OFF
    assert (gateway.n.line.lost_off[0], there(b)) == (2, [])
    gateway.n.line.p = 0.0
    one_pass(gateway, 2 * S)  # 1408 recessive bits
    assert line.state_of(gateway.n.line, 0) == SenderState.ACTIVE
    send(a, 4)
    one_pass(gateway)
    one_pass(gateway, S)
    assert there(b) == [4]


def test_how_late_a_frame_was_is_measured(make: Make) -> None:
    gateway, a, _ = make(1000)
    one_pass(gateway)
    send(a, 1)
    one_pass(gateway)
    one_pass(gateway, 10 * S)
    due_us = 1e3 * int(gateway.n.line.longest[0])
    assert gateway.late_us()["max"] > 10e6 - due_us - 1e3, gateway.late_us()
    assert gateway.late_us()["p50"] == gateway.late_us()["max"], "there was one"


def test_in_its_thread_it_carries_both_ways_and_never_before_the_bits_have_passed(
    make: Make,
) -> None:
    gateway, a, b = make(100_000)
    send(a, *range(20))
    send(b, *range(100, 120))
    begin = time.monotonic()
    thread = threading.Thread(target=gateway.carry, daemon=True)
    thread.start()
    heard = {}
    for name, end in (("a", a), ("b", b)):
        heard[name] = found = []
        while len(found) < 20:
            if wire.get_frame(end, True) == Arrival.FRAME:
                found.append(int(end.rx[0]))
    took_s = time.monotonic() - begin
    gateway.stop()
    thread.join()
    assert heard == {"a": [*range(100, 120)], "b": [*range(20)]}
    busy_s = int(gateway.n.line.busy) / int(gateway.n.line.per_s)
    assert took_s > busy_s - 3e-5, f"{took_s} s for {busy_s} s of bits"
    assert gateway.not_taken == 0


def test_the_gateway_itself_adds_no_frame_and_none_comes_back(make: Make) -> None:
    gateway, a, b = make()
    one_pass(gateway)
    send(a, 7)
    for _ in range(5):
        one_pass(gateway, S)
    assert there(b) == [7]
    assert there(a) == []
    assert gateway.n.line.sent.sum() == 1


@given(st.integers(1, 10**6), st.integers(0, 10**16))
def test_bits_and_times_agree_also_after_months(bitrate: int, ns: int) -> None:
    bit = int(tick_at(bitrate, ns))
    assert bit == ns * bitrate // S
    assert ns_of(bitrate, bit) == -(-bit * S // bitrate) <= ns
    assert tick_at(bitrate, ns_of(bitrate, bit)) == bit
