"""The loop that plays frames, on a pair of connected sockets in place of a CAN socket."""

import socket
import threading
from collections.abc import Iterator
from errno import ENOTCONN
from typing import Any

import numpy as np
import pytest
from places import PATIENCE_S

from pcpc.drivers.can import wire
from pcpc.drivers.can.wire_layout import Medium
from pcpc.executive.nodes.player import Player, note


@pytest.fixture
def line() -> Iterator[tuple[Any, socket.socket]]:
    """Return (player of ten frames, 1 ms apart, in laps of 10 ms; the other end of its line)."""
    mine, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    numbers = np.arange(10)
    rows = np.zeros((10, 16), np.uint8)
    rows[:, 0] = numbers
    rows[:, 4] = 8
    made = Player(rows, 1_000_000 * numbers, 10_000_000, timed=True)
    wire.prepare(made.n.wire, Medium.SOCKETCAN, mine.fileno(), mine.fileno())
    other.settimeout(PATIENCE_S)
    with mine, other:
        yield made, other


def test_laps_follow_each_other_on_one_time_base(line: tuple[Player, socket.socket]) -> None:
    made, other = line
    start = made.soon_ns(1_000_000, 250_000)
    made.play(start, 3)
    order = [other.recv(16)[0] for _ in range(30)]
    assert order == 3 * list(range(10)), order
    assert (start % 1_000_000, made.count("sent")) == (250_000, 30)
    planned = made.count("last_due") - made.count("first_due")
    assert planned == 29_000_000, f"{planned} ns from the first deadline to the last"


def test_no_frame_leaves_before_its_time(line: tuple[Player, socket.socket]) -> None:
    made, _ = line
    made.play(made.soon_ns(1_000_000, 0), 2)
    early = made.count("last_due") - made.count("last_sent")
    assert early < 0, f"the last frame left {early} ns before its deadline"
    assert 0.0 < made.error_us(0.5) <= made.error_us(0.99) <= 1e-3 * made.count("max_ns")
    assert int(made.n.bins.sum()) == 20


def test_a_player_that_is_late_sends_everything_in_order(
    line: tuple[Player, socket.socket],
) -> None:
    made, other = line
    made.play(made.soon_ns(1_000_000, 0) - 1_000_000_000, 1)  # a stall of one second
    order = [other.recv(16)[0] for _ in range(10)]
    assert order == list(range(10)), order
    assert made.error_us(0.01) > 0.9e6, f"error {made.error_us(0.01):.0f} us"


def test_a_full_queue_is_waited_for(line: tuple[Player, socket.socket]) -> None:
    made, other = line
    made.n.timed = 0
    thread = threading.Thread(target=made.play, args=(0, 200))
    thread.start()  # 2000 frames do not fit; they go as fast as they are taken
    order = [other.recv(16)[0] for _ in range(2000)]
    thread.join()
    assert order == 200 * list(range(10))
    assert (made.count("errors"), made.count("sent")) == (0, 2000)
    assert made.count("waited") > 0, "the queue was never full"


def test_a_frame_that_is_refused_is_counted_and_the_next_has_its_turn(
    line: tuple[Player, socket.socket],
) -> None:
    made, other = line
    other.close()
    made.play(made.soon_ns(1_000_000, 0), 2)
    errors, errno = made.count("errors"), made.count("errno")
    assert (errors, made.count("sent"), errno) == (20, 0, ENOTCONN), f"{errors} errors, {errno}"


def test_an_endless_player_stops_when_it_is_asked(line: tuple[Player, socket.socket]) -> None:
    made, other = line
    thread = threading.Thread(target=made.play, args=(made.soon_ns(1_000_000, 0), 0))
    thread.start()
    for _ in range(25):
        other.recv(16)
    made.stop()
    thread.join(PATIENCE_S)
    assert not thread.is_alive(), f"still playing after {made.count('sent')} frames"


@pytest.mark.parametrize("error_ns", [0, 7, 255, 256, 12_345, 200_000, 7_654_321, 3 * 10**12])
def test_a_percentile_is_within_one_percent(error_ns: int) -> None:
    made = Player(np.zeros((1, 16), np.uint8), np.zeros(1, np.int64), 0, timed=True)
    note(made.n, error_ns)
    note(made.n, 10**14)
    found = 1e3 * made.error_us(0.5)
    assert error_ns - 1e-3 <= found <= 1.01 * error_ns + 1e-3, f"{error_ns} ns counts as {found}"
