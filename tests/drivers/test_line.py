"""The CAN line: arbitration, response times, error frames, error counters, bus off, queues."""

import itertools
import math
import os
import random
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from test_frame_bits import arbitration, classic_frame, classic_stream

from pcpc.drivers.can import line as lines
from pcpc.drivers.can.line import Condition, Outcome
from pcpc.tools.start.bus.response import Message, responses_ns

A, B, C = range(3)
Arrival = tuple[int, int, NDArray[np.uint8]]  # bit, sender, frame
LONGEST_BITS = 135 + 25


def frame(can_id: int, data: bytes = b"", extended: bool = False) -> NDArray[np.uint8]:
    word = can_id | int(extended) << 31
    packed = word.to_bytes(4, "little") + bytes([len(data), 0, 0, 0]) + data.ljust(8, b"\0")
    return np.frombuffer(packed, np.uint8)


def new(senders: int = 2, room: int = 64, **options: Any) -> Any:
    line: Any = np.zeros(1, lines.LINE).view(np.recarray)[0]
    lines.prepare(line, senders, room, **options)
    return line


def bits(one: NDArray[np.uint8]) -> int:
    """Return the length of a frame with its intermission, of an encoder of lists."""
    word = int.from_bytes(one[:4].tobytes(), "little")
    return classic_frame(word & 0x1FFFFFFF, word >> 31 == 1, one[8 : 8 + one[4]].tobytes())


def events(line: Any, until: int) -> list[tuple[int, int, int]]:
    """Return what happens up to bit `until`: what, when, to whom."""
    found = []
    while (what := lines.advance(line, until)) != Outcome.NOTHING:
        found.append((int(what), int(line.at), int(line.who)))
    return found


def sent(line: Any, arrivals: Iterable[Arrival], until: int) -> list[tuple[bytes, int]]:
    """Return the frames that come through, in order, each with the bits that it took."""
    found = []
    for at, group in itertools.groupby(
        [*sorted(arrivals, key=lambda a: a[:2]), (until, -1, frame(0))], key=lambda a: a[0]
    ):
        while (what := lines.advance(line, at)) != Outcome.NOTHING:
            if what == Outcome.SENT:
                found.append((line.frame[:16].tobytes(), int(line.waited)))
        for _, s, one in group:
            if s >= 0:
                lines.put(line, s, one, at)
    return found


# ----------------------------------------------------------------------------- arbitration, times

IDS = st.booleans().flatmap(
    lambda long: st.tuples(st.integers(0, 2**29 - 1 if long else 2**11 - 1), st.just(long))
)


@given(st.lists(IDS, min_size=2, max_size=8, unique=True), st.randoms(use_true_random=False))
@settings(max_examples=100, deadline=None)
def test_the_first_recessive_bit_loses(ids: list[tuple[int, bool]], draw: random.Random) -> None:
    """What waits goes in the order in which wired-AND lets it: by the bits of the arbitration."""
    line = new(4)
    for can_id, long in ids:
        lines.put(line, draw.randrange(4), frame(can_id, b"", long), 0)
    order = sorted(ids, key=lambda one: arbitration(*one))
    assert [raw for raw, _ in sent(line, [], 2000)] == [
        frame(can_id, b"", long).tobytes() for can_id, long in order
    ]


def test_a_frame_on_the_line_is_not_interrupted_and_the_next_follows_its_intermission() -> None:
    slow, urgent = frame(0x700, bytes(8)), frame(1)
    line = new()
    through = sent(line, [(10, A, slow), (11, B, urgent)], 500)
    assert through == [
        (slow.tobytes(), bits(slow) - 3),
        (urgent.tobytes(), bits(slow) - 1 + bits(urgent) - 3),
    ]
    assert line.busy == bits(slow) + bits(urgent)


def test_in_order_the_oldest_of_a_sender_goes_first_and_senders_still_arbitrate() -> None:
    arrivals = [(0, A, frame(0x300)), (0, A, frame(0x100)), (0, B, frame(0x200))]

    def order(in_order: bool) -> list[int]:
        through = sent(new(in_order=in_order), arrivals, 1000)
        return [int.from_bytes(raw[:4], "little") for raw, _ in through]

    assert order(False) == [0x100, 0x200, 0x300]
    assert order(True) == [0x200, 0x300, 0x100]


def test_what_does_not_fit_into_a_queue_is_refused_and_counted() -> None:
    line = new(room=3)
    taken = [lines.put(line, A, frame(i), 0) for i in range(5)]
    assert taken == [True, True, True, False, False]
    assert (line.refused[A], line.most_waiting[A]) == (2, 3)
    assert len(sent(line, [], 1000)) == 3 == line.sent[A]


def traffic(draw: random.Random) -> list[tuple[Message, NDArray[np.uint8]]]:
    """Return frames by priority, with their real lengths; load between 30 and 97 %."""
    while True:
        found = []
        for can_id in sorted(draw.sample(range(2048), draw.randint(2, 8))):
            one = frame(can_id, draw.randbytes(draw.randrange(9)))
            found.append((Message(bits(one), draw.choice([500, 700, 1000, 2000, 3100])), one))
        if 0.3 < math.fsum(k.transmission_ns / k.period_ns for k, _ in found) < 0.97:
            return found


@given(st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_no_frame_takes_longer_than_the_analysis_says(seed: int) -> None:
    draw = random.Random(seed)
    frames = traffic(draw)
    bounds = responses_ns([k for k, _ in frames], 1)
    arrivals = []
    for k, one in frames:
        begin, s = draw.choice([0, 0, draw.randrange(k.period_ns)]), draw.randrange(3)
        arrivals += [(at, s, one) for at in range(begin, 12_000, k.period_ns)]
    bound_of = {one.tobytes(): bound for (_, one), bound in zip(frames, bounds, strict=True)}
    for raw, waited in sent(new(3), arrivals, 12_000):
        bound = bound_of[raw]
        assert bound is None or waited + 3 <= bound, f"{waited} + 3 bits, bound {bound}"


@pytest.mark.parametrize("seed", range(10))
def test_what_is_put_ahead_of_its_time_goes_as_if_it_had_come_then(seed: int) -> None:
    draw = random.Random(seed)
    arrivals = [
        (draw.randrange(5000), draw.randrange(2), frame(draw.randrange(2048))) for _ in range(60)
    ]
    line = new()
    for at, s, one in sorted(arrivals, key=lambda a: a[0]):
        lines.put(line, s, one, at)
    assert sent(line, [], 20_000) == sent(new(), arrivals, 20_000)


def test_a_bit_that_is_closed_begins_what_waits_and_the_rest_comes_too_late() -> None:
    line = new()
    lines.put(line, A, frame(0x700), 50)
    assert events(line, 50) == []
    lines.close(line, 50)
    lines.put(line, B, frame(1), 50)
    assert lines.next_due(line) == 50 + bits(frame(0x700)) - 3
    assert [at for _, at, _ in events(line, 1000)] == [
        50 + bits(frame(0x700)) - 3,
        50 + bits(frame(0x700)) + bits(frame(1)) - 3,
    ]


@pytest.mark.parametrize("seed", range(20))
def test_the_bound_is_reached_within_a_bit_when_all_come_as_a_lower_frame_has_begun(
    seed: int,
) -> None:
    frames = traffic(random.Random(seed))
    bounds = responses_ns([k for k, _ in frames], 1)
    for m, (bound, (_, own)) in enumerate(zip(bounds, frames, strict=True)):
        lower = max((k for k in frames[m + 1 :]), key=lambda k: k[0].transmission_ns, default=None)
        arrivals = [] if lower is None else [(0, C, lower[1])]
        for k, one in frames[: m + 1]:
            arrivals += [(at, A, one) for at in range(1, 30_000, k.period_ns)]
        through = sent(new(3, room=256), arrivals, 30_000)
        most = max(waited for raw, waited in through if raw == own.tobytes()) + 3
        assert bound is not None
        assert bound - 1 <= most <= bound, f"frame {m}: {most} bits, bound {bound}"


# ---------------------------------------------------------------------------------- error frames


def error_frame(stream: Sequence[int], hit: int, passive: bool, lengths: int = 10) -> int:
    """Return the bit at which the line is idle again: a sender and a receiver, bit by bit.

    Both read the wired-AND of what they drive, with bit `hit` flipped. A receiver drives its flag
    after the sixth equal bit, or at once where the form is fixed; then all wait for the first
    recessive bit, and ten more are delimiter and intermission.
    """
    read: list[int] = []
    flags = {"sender": -1, "receiver": -1}  # the bit at which each begins
    while True:
        at = len(read)
        levels = [1 if passive else 0] * sum(at in range(f, f + 6) for f in flags.values() if f > 0)
        read.append(stream[at] ^ (at == hit) if at <= hit else min(levels, default=1))
        if at == hit:
            flags["sender"] = at + 1
            if at >= len(stream) - lengths:
                flags["receiver"] = at + 1
        if flags["receiver"] < 0 and len(read) >= 6 and len(set(read[-6:])) == 1:
            flags["receiver"] = at + 1
        last = max(flags.values()) + 6
        if min(flags.values()) > 0 and at == last:
            return last + 11  # eight of delimiter from `last` on, three of intermission


@pytest.mark.parametrize("passive", [False, True], ids=["active", "passive"])
def test_an_error_frame_is_as_long_as_two_controllers_make_it(passive: bool) -> None:
    draw = random.Random(1)
    for _ in range(40):
        one = frame(draw.getrandbits(11), bytes(draw.choices([0, 255, 0x5A], k=draw.randrange(9))))
        word = int.from_bytes(one[:4].tobytes(), "little")
        stream = classic_stream(word, False, one[8 : 8 + one[4]].tobytes())
        for hit in range(len(stream) - 1):
            line = new()
            for s in (A, B):
                line.transmit_errors[s] = 128 if passive else 0
            lines.put(line, A, one, 0)
            assert lines.advance(line, 1) == Outcome.NOTHING, "it has begun"
            line.hit, line.due = hit, hit + 1
            assert events(line, hit + 1) == [(Outcome.ERROR, hit + 1, A)]
            expected = error_frame(stream, hit, passive)
            assert line.free_at == expected, f"hit {hit} of {stream}"
            assert line.busy == expected <= hit + 1 + 23


def test_the_frame_comes_again_after_an_error_and_its_wait_counts_from_the_first_time() -> None:
    one = frame(0x123, b"\x55\xaa")
    line = new(p=1.0)
    lines.put(line, A, one, 0)
    assert [what for what, *_ in events(line, 20)] == [Outcome.ERROR]
    again = int(line.free_at)
    line.p = 0.0
    assert events(line, 1000) == [(Outcome.SENT, again + bits(one) - 3, A)]
    assert line.waited == again + bits(one) - 3
    assert line.errors[A] == 1 == line.sent[A]


# --------------------------------------------------------------------------------- error counters


def failing(line: Any, s: int, times: int) -> list[tuple[int, int, int]]:
    """Let a frame of `s` fail so often; return the events."""
    lines.put(line, s, frame(s), int(line.free_at))
    line.p, found = 1.0, []
    while len(found) < times:
        found += events(line, lines.next_due(line))
    line.p = 0.0
    return found


def test_the_counters_pass_warning_passive_and_bus_off_where_the_standard_says() -> None:
    line = new(3)
    states = []
    for n in range(1, 33):
        (event,) = failing(line, A, 1)
        states.append(lines.state_of(line, A))
        assert line.transmit_errors[A] == 8 * n
        assert line.receive_errors[B] == line.receive_errors[C] == n
        assert event[0] == (Outcome.ERROR if n < 32 else Outcome.BUS_OFF)
        line.waiting[A] = min(line.waiting[A], 1)
    expected = (
        [Condition.ACTIVE] * 11
        + [Condition.WARNING] * 4
        + [Condition.PASSIVE] * 16
        + [Condition.OFF]
    )
    assert states == expected, "96 is the 12th, 128 the 16th, 256 the 32nd"
    assert (line.times_off[A], line.worst[A]) == (1, 256)


def test_every_frame_that_passes_takes_one_off_each_counter() -> None:
    line = new(3)
    line.transmit_errors[A], line.receive_errors[B], line.receive_errors[C] = 2, 200, 1
    for tec, rec_b, rec_c in ((1, 127, 0), (0, 126, 0), (0, 125, 0)):
        lines.put(line, A, frame(1), int(line.free_at))
        events(line, int(line.free_at) + LONGEST_BITS)
        now = (line.transmit_errors[A], line.receive_errors[B], line.receive_errors[C])
        assert now == (tec, rec_b, rec_c)


def test_a_passive_sender_lets_the_others_go_first_for_eight_bits() -> None:
    def second(tec: int) -> tuple[bytes, int]:
        line = new()
        line.transmit_errors[A] = tec
        arrivals = [(0, A, frame(1)), (0, A, frame(2)), (bits(frame(1)) + 7, B, frame(0x7FF))]
        return sent(line, arrivals, 1000)[1]

    assert second(0)[0] == frame(2).tobytes()
    assert second(127)[0] == frame(2).tobytes()
    assert second(129)[0] == frame(0x7FF).tobytes()
    alone = new()
    alone.transmit_errors[A] = 200
    through = sent(alone, [(0, A, frame(1)), (0, A, frame(2))], 1000)
    assert through[1][1] == bits(frame(1)) + 8 + bits(frame(2)) - 3


# ------------------------------------------------------------------------------ bus off, recovery


def test_bus_off_ends_after_128_times_11_recessive_bits() -> None:
    line = new()
    *_, (what, _, who) = failing(line, A, 32)
    assert (what, who) == (Outcome.BUS_OFF, A)
    assert not lines.put(line, A, frame(5), int(line.free_at)), "who is off sends nothing"
    assert line.lost_off[A] == 2, "what waited, and what came then"
    delimiter = int(line.free_at) - 11
    assert lines.next_due(line) == delimiter + 128 * 11
    assert events(line, delimiter + 128 * 11 - 1) == []
    assert events(line, delimiter + 128 * 11) == [(Outcome.RECOVERED, delimiter + 128 * 11, A)]
    assert line.transmit_errors[A] == line.receive_errors[A] == 0
    assert lines.put(line, A, frame(5), int(line.at))


def test_between_frames_of_others_there_is_one_run_of_recessive_bits_each() -> None:
    line = new(3, room=256)
    failing(line, A, 32)
    begin, one = int(line.free_at), frame(7, b"\x12\x34")
    assert int(line.runs_left[A]) == 128
    for _ in range(200):
        lines.put(line, B, one, begin)
    found = events(line, begin + 200 * bits(one))
    place = [what for what, *_ in found].index(Outcome.RECOVERED)
    assert place == 127, "the end of the error frame is the first run, then one a frame"


def test_who_is_alone_gets_no_acknowledgement_and_never_goes_off_by_it() -> None:
    line = new()
    failing(line, B, 32)
    lines.put(line, A, frame(1, b"\x01"), int(line.free_at))
    found = events(line, int(line.free_at) + 40_000)
    whats = [what for what, *_ in found]
    assert whats.count(Outcome.SENT) == 1 and whats[-1] == Outcome.SENT, "once B is back"
    back = whats.index(Outcome.RECOVERED)
    assert set(whats[:back]) == {Outcome.ERROR} and back > 16
    assert line.worst[A] == 128 and line.times_off[A] == 0
    slot = bits(frame(1, b"\x01")) - 3 - 9
    first, second = (at for _, at, _ in found[:2])
    assert second - first == 6 + 8 + 3 + slot + 1, "flag, delimiter, intermission, to the slot"


# --------------------------------------------------------------------------------------- chance


def drawn(
    seed: int, p: float, burst: float = 1.0, frames: int = 3000
) -> tuple[list[tuple[int, int, int]], Any]:
    line = new(p=p, burst=burst, seed=seed)
    found = []
    for k in range(frames):
        lines.put(line, k % 2, frame(k % 7, bytes([k % 251] * 8)), 200 * k)
        found += events(line, 200 * (k + 1))
    return found, line


def test_equal_seeds_give_equal_events_and_others_do_not() -> None:
    once, line = drawn(1, 1e-3, 2.0)
    again, other = drawn(1, 1e-3, 2.0)
    assert once == again and line.tobytes() == other.tobytes()
    assert drawn(2, 1e-3, 2.0)[0] != once


def test_interpreted_it_gives_the_same_events() -> None:
    code = "from test_line import drawn; print(drawn(1, 3e-3, 2.0, 200)[0])"
    paths = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[2])])
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": paths},
    )
    found = drawn(1, 3e-3, 2.0, 200)[0]
    assert done.stdout.strip() == str(found) and len(found) > 250


@pytest.mark.parametrize("p", [1e-5, 1e-4, 1e-3])
def test_as_many_frames_are_hit_as_bits_are(p: float) -> None:
    whats = [what for what, *_ in drawn(3, p)[0]]
    n, errors = len(whats), whats.count(Outcome.ERROR)
    each = 1.0 - (1.0 - p) ** 118  # 8 equal bytes: 108 bits and some stuffing
    assert abs(errors - n * each) < 4.0 * math.sqrt(n * each) + 0.15 * n * each, f"{errors} of {n}"


def test_a_burst_hits_as_many_transmissions_in_a_row_as_it_says() -> None:
    whats = [what for what, *_ in drawn(4, 1e-4, 4.0)[0]]
    runs = [len(list(group)) for hit, group in itertools.groupby(whats, Outcome.SENT.__ne__) if hit]
    mean = sum(runs) / len(runs)
    assert abs(mean - 4.0) < 4.0 * math.sqrt(12.0 / len(runs)), f"{mean} in {len(runs)} bursts"
