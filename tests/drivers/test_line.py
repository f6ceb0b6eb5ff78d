"""The CAN line, classic and CAN FD: arbitration, times at one and two bit rates, bounds, queues."""

import math
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from line_kinds import (
    BIT,
    FAST,
    FD,
    RATES,
    A,
    Arrival,
    B,
    C,
    Kind,
    both,
    events,
    new,
    sent,
)  # fmt: skip
from second_encoder import FD_LENGTHS, Bytes, arbitration, fd_frame, frame, stream

from pcpc.drivers.can.frame_bits import fd_bits
from pcpc.drivers.compiled.rows import Flag
from pcpc.drivers.line import line as lines
from pcpc.tools.start.bus.response import Message, responses_ns

BRS, ESI = Flag.BRS, Flag.ESI

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


@both
def test_a_frame_on_the_line_is_not_interrupted_and_the_next_follows_its_intermission(
    kind: Kind,
) -> None:
    slow, urgent = kind.frame(0x700, bytes(8)), kind.frame(1, b"")
    line = kind.new()
    first, second = kind.ticks(slow), kind.ticks(urgent)
    assert sent(line, [(10, A, slow), (11, B, urgent)], 500 * kind.bit) == [
        (slow.tobytes(), first - 3 * kind.bit),
        (urgent.tobytes(), first - 1 + second - 3 * kind.bit),
    ]
    assert line.busy == first + second


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


@both
@pytest.mark.parametrize("seed", range(10))
def test_what_is_put_ahead_of_its_time_goes_as_if_it_had_come_then(seed: int, kind: Kind) -> None:
    draw, arrivals = random.Random(seed), list[Arrival]()
    for _ in range(60):
        arrivals.append((draw.randrange(5000 * kind.bit), draw.randrange(2), kind.mixed(draw)))
    line, until = kind.new(), 20_000 * kind.bit
    for at, s, one in sorted(arrivals, key=lambda a: a[0]):
        lines.put(line, s, one, at)
    assert sent(line, [], until) == sent(kind.new(), arrivals, until)


@both
def test_a_bit_that_is_closed_begins_what_waits_and_the_rest_comes_too_late(kind: Kind) -> None:
    line, one, late = kind.new(), kind.frame(0x700, b""), kind.frame(1, b"")
    lines.put(line, A, one, 50)
    assert events(line, 50) == []
    lines.close(line, 50)
    lines.close(line, 50)  # it has begun
    lines.put(line, B, late, 50)
    end = 50 + kind.ticks(one) - 3 * kind.bit
    assert lines.next_due(line) == end
    found = [at for _, at, _ in events(line, 1000 * kind.bit)]
    assert found == [end, end + kind.ticks(late)]


@pytest.mark.parametrize(
    ("senders", "room"), [(0, 1), (lines.SENDERS + 1, 1), (1, 0), (1, lines.MOST_ROOM + 1)]
)
def test_a_line_has_so_many_senders_and_so_much_room(senders: int, room: int) -> None:
    line: Any = np.zeros(1, lines.Line.dtype).view(np.recarray)[0]
    with pytest.raises(ValueError, match=f"{senders} senders with room for {room}: at most "):
        lines.prepare(line, senders, room, bitrate=500_000)


# ------------------------------------------------------------------------------------------ bounds


def traffic(kind: Kind, draw: random.Random) -> list[tuple[Message, Bytes]]:
    """Return frames by priority, with their real times in ticks; load between 30 and 97 %."""
    while True:
        found = []
        for can_id in sorted(draw.sample(range(2048), draw.randint(2, 8))):
            one, period = kind.mixed(draw, can_id), draw.choice([500, 700, 1000, 2000, 3100])
            found.append((Message(kind.ticks(one), period * kind.bit), one))
        if 0.3 < math.fsum(k.transmission_ns / k.period_ns for k, _ in found) < 0.97:
            return found


@both
@given(seed=st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_no_frame_takes_longer_than_the_analysis_says(seed: int, kind: Kind) -> None:
    draw = random.Random(seed)
    frames = traffic(kind, draw)
    bounds = responses_ns([k for k, _ in frames], 1)
    arrivals, until = list[Arrival](), 12_000 * kind.bit
    for k, one in frames:
        begin, s = draw.choice([0, 0, draw.randrange(k.period_ns)]), draw.randrange(3)
        arrivals += [(at, s, one) for at in range(begin, until, k.period_ns)]
    bound_of = {one.tobytes(): bound for (_, one), bound in zip(frames, bounds, strict=True)}
    for raw, waited in sent(kind.new(3), arrivals, until):
        took, bound = waited + 3 * kind.bit, bound_of[raw]
        assert bound is None or took <= bound, f"{took} ticks, bound {bound}"


@both
@pytest.mark.parametrize("seed", range(20))
def test_the_bound_is_reached_within_a_tick_when_all_come_as_a_lower_frame_has_begun(
    seed: int, kind: Kind
) -> None:
    frames, until = traffic(kind, random.Random(seed)), 30_000 * kind.bit
    bounds = responses_ns([k for k, _ in frames], 1)
    for m, (bound, (_, own)) in enumerate(zip(bounds, frames, strict=True)):
        lower = max((k for k in frames[m + 1 :]), key=lambda k: k[0].transmission_ns, default=None)
        arrivals = [] if lower is None else [(0, C, lower[1])]
        for k, one in frames[: m + 1]:
            arrivals += [(at, A, one) for at in range(1, until, k.period_ns)]
        through = sent(kind.new(3, room=256), arrivals, until)
        most = max(waited for raw, waited in through if raw == own.tobytes()) + 3 * kind.bit
        assert bound is not None
        assert bound - 1 <= most <= bound, f"frame {m}: {most} ticks, bound {bound}"


def with_most_stuff_bits(n: int) -> Bytes:
    """Return a frame whose data bits are like the bit before: a stuff bit behind each fourth."""
    empty = stream(fd_frame(0x078, bytes(n)))
    wire, data = empty.body[: len(empty.head) + 5], ""  # to the DLC, where nothing is stuffed
    for _ in range(8 * n):
        data += wire[-1]
        wire += wire[-1]
        if wire[-5:] == 5 * wire[-1]:
            wire += str(1 - int(wire[-1]))
    return fd_frame(0x078, int(data, 2).to_bytes(n, "big"))


@pytest.mark.parametrize("n", [8, 16, 48, 64])
def test_the_longest_frame_is_just_within_its_bound(n: int) -> None:
    """Three stuff bits may be missing, and the bound takes the CRC delimiter for a nominal bit."""
    one = with_most_stuff_bits(n)
    nominal, data = fd_bits(n)
    ((_, waited),) = sent(FD.new(), [(0, A, one)], 5000)
    short = BIT * nominal + FAST * data - (waited + 3 * BIT)
    assert BIT - FAST <= short <= BIT - FAST + 3 * FAST, f"{short} ticks"


# ------------------------------------------------------------------------------------ two bit rates


@pytest.mark.parametrize("flags", [0, BRS], ids=["nominal", "switched"])
@pytest.mark.parametrize("n", FD_LENGTHS)
def test_a_frame_takes_the_time_of_its_bits(n: int, flags: int) -> None:
    one = fd_frame(0x123, bytes(range(n)), flags=flags)
    (through,) = sent(FD.new(), [(7, A, one)], 20_000)
    assert through == (one.tobytes(), FD.ticks(one) - 3 * BIT)
    bits = len(stream(one).bits)
    assert flags or through[1] == BIT * bits, "without a switch all bits are nominal"


def test_with_one_bit_rate_a_switch_changes_no_time() -> None:
    for flags in (0, BRS):
        one = fd_frame(0x123, bytes(64), flags=flags)
        ((_, waited),) = sent(new(), [(0, A, one)], 2000)
        assert waited == len(stream(one).bits)


@pytest.mark.parametrize(
    ("rates", "per_s", "bit", "fast"),
    [((1_000_000, 5_000_000), 5_000_000, 5, 1), ((500_000, 2_000_000), 2_000_000, 4, 1),
     ((800_000, 5_000_000), 20_000_000, 25, 4), ((1_000_000, None), 1_000_000, 1, 1)],
)  # fmt: skip
def test_ticks_divide_the_bits_of_both_rates(
    rates: tuple[int, int | None], per_s: int, bit: int, fast: int
) -> None:
    line = new(bitrate=rates[0], data_bitrate=rates[1])
    assert (line.per_s, line.bit, line.fast) == (per_s, bit, fast)


def test_rates_without_a_common_clock_are_refused() -> None:
    with pytest.raises(ValueError, match="no common tick"):
        new(bitrate=999_983, data_bitrate=4_999_999)


def test_classic_and_fd_frames_share_the_line_by_their_ids_and_none_changes() -> None:
    draw = random.Random(1)
    for _ in range(20):
        frames = [FD.mixed(draw) for _ in range(12)]
        through = sent(new(3, **RATES), [(0, draw.randrange(3), one) for one in frames], 100_000)
        order = sorted(frames, key=lambda one: int(lines.urgency_of(one)))
        assert [raw for raw, _ in through] == [one.tobytes() for one in order]
        ends = np.cumsum([FD.ticks(one) for one in order]) - 3 * BIT
        assert [waited for _, waited in through] == ends.tolist()


def test_a_passive_sender_says_so_in_its_fd_frames_alone() -> None:
    line: Any = FD.new()
    line.transmit_errors[A] = 200
    arrivals = [(0, A, fd_frame(1, b"\1")), (0, A, frame(2, b"\2")), (0, B, fd_frame(3, b"\3"))]
    through = sent(line, arrivals, 20_000)
    assert list(dict.fromkeys(raw[0] for raw, _ in through)) == [1, 3, 2]
    flags = {raw[0]: raw[5] for raw, _ in through}
    assert flags == {1: Flag.FD | BRS | ESI, 2: 0, 3: Flag.FD | BRS}
