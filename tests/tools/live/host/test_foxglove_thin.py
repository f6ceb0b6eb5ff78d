"""What goes to Foxglove of all that a node records, and what a client that never reads holds up."""

import resource
import struct
import threading
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
import pytest
from foxglove.websocket import ServerListener
from foxglove_client import ANSWER_S, PROTOCOL
from hypothesis import given
from hypothesis import strategies as st
from websockets.sync.client import connect

from pcpc.tools.live.host.foxglove.server import QUEUE
from pcpc.tools.live.host.foxglove.thinning import RATE_HZ, Thinning

MS = 10**6
SLOT = 20  # cycles of 1 ms


def of_cycles(cycles: list[int]) -> np.ndarray:
    """Return rows of cycles; only the first word counts."""
    rows = np.zeros((len(cycles), 5), np.int64)
    rows[:, 0] = cycles
    return rows


@given(skipped=st.sets(st.integers(0, 399)), cuts=st.lists(st.integers(0, 400), max_size=8))
def test_each_slot_sends_its_first_cycle_however_it_was_read(
    skipped: set[int], cuts: list[int]
) -> None:
    cycles = [k for k in range(400) if k not in skipped]
    thin, sent = Thinning(MS, True), list[int]()
    ends = [0, *sorted(min(cut, len(cycles)) for cut in cuts), len(cycles)]
    for begin, end in pairwise(ends):
        sent += thin.cycles(of_cycles(cycles[begin:end]))[:, 0].tolist()
    first = {
        slot: min(k for k in cycles if k // SLOT == slot) for slot in {k // SLOT for k in cycles}
    }
    assert sent == sorted(first.values())
    assert len(sent) <= RATE_HZ * 0.4


@pytest.mark.parametrize("period_ns", [MS, 5 * MS, 20 * MS, 7 * MS, 100 * MS])
def test_no_rate_is_above_the_limit(period_ns: int) -> None:
    cycles = [*range(2000)]
    sent = Thinning(period_ns, True).cycles(of_cycles(cycles))
    rate_hz = (len(sent) - 1) / ((sent[-1, 0] - sent[0, 0]) * 1e-9 * period_ns)
    assert rate_hz <= RATE_HZ, rate_hz
    assert rate_hz >= min(RATE_HZ / 2, 1e9 / period_ns) * (1 - 1e-9)


def test_without_a_clock_a_look_sends_one_of_each() -> None:
    thin = Thinning(MS, False)
    assert len(thin.cycles(of_cycles([]))) == len(thin.frames(of_frames([], [1]))) == 0
    for look in range(5):
        cycles = [*range(500 * look, 500 * (look + 1))]
        assert thin.cycles(of_cycles(cycles))[:, 0].tolist() == [500 * look + 480]
        assert len(thin.frames(of_frames(cycles, [1, 2, 3]))) == 1


def of_frames(cycles: list[int], ids: list[int]) -> np.ndarray:
    """Return the frames of `ids`, one each a cycle, all received."""
    rows = np.zeros((len(cycles) * len(ids), 5), np.int64)
    rows[:, 2] = np.repeat(cycles, len(ids))
    rows[:, 1] = rows[:, 2] * MS
    rows[:, 3] = np.tile(ids, len(cycles)) | 8 << 32 | 1 << 40
    return rows


def test_all_kinds_of_frames_come_in_turn_and_a_rare_one_at_once() -> None:
    rows = of_frames([*range(700)], [0x100, 0x101, 0x102, 0x80000103, 0x104])
    sent_ones = rows[rows[:, 3] & 0xFFFFFFFF == 0x104]
    sent_ones[:, 3] ^= 1 << 40  # the same id the other way is another kind
    rare = of_frames([433], [0x7FF])
    rows = np.concatenate((rows, sent_ones, rare))
    rows = rows[np.argsort(rows[:, 1], kind="stable")]
    thin = Thinning(MS, True)
    sent = np.concatenate([thin.frames(part) for part in np.array_split(rows, 13)])
    counts = Counter((int(word) & 0xFFFFFFFF, int(word) >> 40) for word in sent[:, 3])
    assert len(sent) == 700 // SLOT - 1 and counts.pop((0x7FF, 1)) == 1
    assert set(counts.values()) <= {5, 6} and len(counts) == 6, counts


class Listener(ServerListener):
    """Counts subscriptions."""

    def __init__(self) -> None:
        self.subscribed = threading.Semaphore(0)

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Count one."""
        self.subscribed.release()


def rss_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def test_a_client_that_never_reads_loses_the_oldest_and_holds_up_nobody() -> None:
    context = foxglove.Context()
    listener = Listener()
    server = foxglove.start_server(
        port=0, context=context, message_backlog_size=QUEUE, server_listener=listener
    )
    channel = foxglove.Channel("/big", message_encoding="json", context=context)
    url, size, count = f"ws://127.0.0.1:{server.port}", 64 * 1024, 8 * QUEUE
    about = {"subprotocols": [PROTOCOL], "proxy": None, "max_queue": 1, "open_timeout": ANSWER_S,
             "close_timeout": 0.1}  # fmt: skip
    wanted = f'{{"op":"subscribe","subscriptions":[{{"id":1,"channelId":{channel.id()}}}]}}'
    with connect(url, **about) as deaf, connect(url, **about) as reader:
        for client in (deaf, reader):
            client.send(wanted)
        assert all(listener.subscribed.acquire(timeout=ANSWER_S) for _ in range(2))
        before_mb, last = rss_mb(), -1
        for i in range(count):
            channel.log(struct.pack("<q", i) + b"x" * size)
        grown_mb = rss_mb() - before_mb
        while last < count - 1:
            said = reader.recv(timeout=ANSWER_S)
            last = struct.unpack_from("<q", said, 13)[0] if isinstance(said, bytes) else last
    server.stop()
    most_mb = 2 * QUEUE * size / 2**20  # of two clients
    assert most_mb < count * size / 2**21, "it would all fit"
    assert grown_mb < 1.5 * most_mb, f"{grown_mb:.0f} MB for {most_mb:.0f} MB of queues"
