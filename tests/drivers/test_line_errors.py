"""Errors on the CAN line, classic and CAN FD: error frames, counters, bus off, recovery, chance."""

import itertools
import math
import random
import re
from collections.abc import Callable
from typing import Any

import pytest
from interpreting import interpreted
from line_kinds import (
    BIT,
    CLASSIC,
    FAST,
    FD,
    A,
    B,
    C,
    Kind,
    both,
    events,
    sent,
    sent_by,
)  # fmt: skip
from second_encoder import FD_LENGTHS, Bytes, fd_frame, frame, parts, stream

from pcpc.drivers.line import line as lines
from pcpc.drivers.line.line import Outcome, SenderState

# ---------------------------------------------------------------------------------- error frames


def classic_idle(one: Bytes, hit: int, passive: bool, lengths: int = 10) -> int:
    """Return the bit at which the line is idle again: a sender and a receiver, bit by bit.

    Both read the wired-AND of what they drive, with bit `hit` flipped. A receiver drives its flag
    after the sixth equal bit, or at once where the form is fixed; then all wait for the first
    recessive bit, and ten more are delimiter and intermission.
    """
    bits, read = [*map(int, stream(one).bits)], list[int]()
    flags = {"sender": -1, "receiver": -1}  # the bit at which each begins
    while True:
        at = len(read)
        levels = [1 if passive else 0] * sum(at in range(f, f + 6) for f in flags.values() if f > 0)
        read.append(bits[at] ^ (at == hit) if at <= hit else min(levels, default=1))
        if at == hit:
            flags["sender"] = at + 1
            if at >= len(bits) - lengths:
                flags["receiver"] = at + 1
        if flags["receiver"] < 0 and len(read) >= 6 and len(set(read[-6:])) == 1:
            flags["receiver"] = at + 1
        last = max(flags.values()) + 6
        if min(flags.values()) > 0 and at == last:
            return last + 11  # eight of delimiter from `last` on, three of intermission


def fd_idle(frame: Bytes, hit: int, passive: bool) -> int:
    """Return the tick at which the line is idle again: a sender and a receiver, each on its clock.

    The receiver reads what the sender's flag leaves on the line at the bit rate that it believes
    in, and judges all that it has read anew with each bit.
    """
    one = stream(frame)
    flipped = str(1 - int(one.bits[hit]))
    read, brs = one.bits[:hit] + flipped, len(one.head) - 1
    begin = now = sum(one.ticks(BIT, FAST)[: hit + 1])
    fixed, end = len(one.body), len(one.body) + len(one.check)

    def wrong() -> bool:
        form = any(read[i] == read[i - 1] for i in range(fixed, min(len(read), end), 5))
        fields = hit >= end or read[end : end + 1] == "0" or len(read) > end + 2
        return form or fields or re.search("000000|111111", read[:fixed]) is not None

    while not wrong():
        fast = read[brs : brs + 1] == "1" and len(read) <= end
        now += FAST if fast else BIT
        read += "1" if passive or now > begin + 6 * BIT else "0"
    return max(begin, now) + 6 * BIT + 11 * BIT


@pytest.mark.parametrize("passive", [False, True], ids=["active", "passive"])
@pytest.mark.parametrize(
    ("kind", "idle_at"), [(CLASSIC, classic_idle), (FD, fd_idle)], ids=["classic", "fd"]
)
def test_an_error_frame_is_as_long_as_two_controllers_make_it(
    kind: Kind, idle_at: Callable[[Bytes, int, bool], int], passive: bool
) -> None:
    draw = random.Random(1)
    for _ in range(40):
        lengths = FD_LENGTHS[: 12 if kind is FD else 9]
        one = kind.frame(
            draw.getrandbits(11), bytes(draw.choices([0, 255, 90], k=draw.choice(lengths)))
        )
        if kind is FD and draw.random() < 0.5:
            one = fd_frame(*parts(one)[::2], flags=0)
        made = sent_by(one, passive)
        lasting = kind.lasting(made)
        for hit in range(len(lasting) - 1):
            line = kind.new()
            for s in (A, B):
                line.transmit_errors[s] = 128 if passive else 0
            lines.put(line, A, one, 0)
            assert lines.advance(line, 1) == Outcome.NOTHING, "it has begun"
            due = sum(lasting[: hit + 1])
            line.hit, line.due = hit, due
            assert events(line, due) == [(Outcome.ERROR, due, A)]
            expected = idle_at(made, hit, passive)
            assert line.free_at == expected, f"hit {hit} of {made}"
            assert line.busy == expected <= due + 23 * kind.bit


@both
def test_the_frame_comes_again_after_an_error_and_its_wait_counts_from_the_first_time(
    kind: Kind,
) -> None:
    one = kind.frame(0x123, kind.longest)
    line, lasting = kind.new(), kind.lasting(one)
    lines.put(line, A, one, 0)
    lines.advance(line, 1)
    line.hit = len(lasting) // 2  # in its data
    line.due = sum(lasting[: line.hit + 1])
    assert [what for what, *_ in events(line, line.due)] == [Outcome.ERROR]
    end = int(line.free_at) + kind.ticks(one) - 3 * kind.bit
    assert events(line, 100_000) == [(Outcome.SENT, end, A)]
    assert line.waited == end
    assert (line.errors[A], line.sent[A], line.receive_errors[B]) == (1, 1, 0)
    assert line.frame[: len(one)].tobytes() == one.tobytes()


# --------------------------------------------------------------------------------- error counters


@both
def test_the_counters_pass_warning_passive_and_bus_off_where_the_standard_says(kind: Kind) -> None:
    line = kind.new(3)
    states = []
    for n in range(1, 33):
        (event,) = kind.failing(line, A, 1)
        states.append(lines.state_of(line, A))
        assert line.transmit_errors[A] == 8 * n
        assert line.receive_errors[B] == line.receive_errors[C] == n
        assert event[0] == (Outcome.ERROR if n < 32 else Outcome.BUS_OFF)
        line.waiting[A] = min(line.waiting[A], 1)
    expected = (
        [SenderState.ACTIVE] * 11
        + [SenderState.WARNING] * 4
        + [SenderState.PASSIVE] * 16
        + [SenderState.OFF]
    )
    assert states == expected, "96 is the 12th, 128 the 16th, 256 the 32nd"
    assert (line.times_off[A], line.worst[A]) == (1, 256)


@both
def test_every_frame_that_passes_takes_one_off_each_counter(kind: Kind) -> None:
    line = kind.new(3)
    line.transmit_errors[A], line.receive_errors[B], line.receive_errors[C] = 2, 200, 1
    for tec, rec_b, rec_c in ((1, 127, 0), (0, 126, 0), (0, 125, 0)):
        lines.put(line, A, kind.frame(1, b""), int(line.free_at))
        events(line, int(line.free_at) + kind.slot)
        now = (line.transmit_errors[A], line.receive_errors[B], line.receive_errors[C])
        assert now == (tec, rec_b, rec_c)


@both
def test_a_passive_sender_lets_the_others_go_first_for_eight_nominal_bits(kind: Kind) -> None:
    ones = kind.frame(1, b"\1"), kind.frame(2, b"\2")

    def begun(tec: int) -> tuple[Any, list[int]]:
        """Return a line whose first sender has an error counter, and the ticks of its frames."""
        line = kind.new()
        line.transmit_errors[A] = tec
        return line, [kind.ticks(sent_by(one, tec > 127)) for one in ones]

    def second(tec: int) -> int:
        line, (first, _) = begun(tec)
        late = (first + 7 * kind.bit, B, kind.frame(0x7FF, b""))
        return sent(line, [*((0, A, one) for one in ones), late], 20_000)[1][0][0]

    assert [second(tec) for tec in (0, 127, 129)] == [2, 2, 0xFF]
    line, took = begun(200)
    through = sent(line, [(0, A, one) for one in ones], 20_000)
    assert through[1][1] == sum(took) + 8 * kind.bit - 3 * kind.bit
    line, _ = begun(200)
    lines.put(line, A, ones[0], 0)
    assert lines.advance(line, 1) == Outcome.NOTHING
    line.hit, line.due = 0, kind.bit
    assert events(line, kind.bit) == [(Outcome.ERROR, kind.bit, A)]
    assert lines.next_due(line) == int(line.free_at) + 8 * kind.bit + 1


# ------------------------------------------------------------------------------ bus off, recovery


@both
def test_bus_off_ends_after_128_times_11_recessive_bits(kind: Kind) -> None:
    line, one = kind.new(), kind.frame(5, b"")
    *_, (what, _, who) = kind.failing(line, A, 32)
    assert (what, who) == (Outcome.BUS_OFF, A)
    assert not lines.put(line, A, one, int(line.free_at)), "who is off sends nothing"
    assert line.lost_off[A] == 2, "what waited, and what came then"
    due = int(line.free_at) + 127 * 11 * kind.bit  # the delimiter is the first
    assert lines.next_due(line) == due
    assert events(line, due - 1) == []
    assert events(line, due) == [(Outcome.RECOVERED, due, A)]
    assert line.transmit_errors[A] == line.receive_errors[A] == 0
    assert lines.put(line, A, one, int(line.at))


@both
def test_between_frames_of_others_there_is_one_run_of_recessive_bits_each(kind: Kind) -> None:
    line = kind.new(3, room=256)
    kind.failing(line, A, 32)
    begin, one = int(line.free_at), kind.frame(7, b"\x12\x34")
    assert int(line.runs_left[A]) == 128
    for _ in range(200):
        lines.put(line, B, one, begin)
    found = events(line, begin + 200 * kind.ticks(one))
    place = [what for what, *_ in found].index(Outcome.RECOVERED)
    assert place == 127, "the end of the error frame is the first run, then one a frame"


def test_who_is_alone_gets_no_acknowledgement_and_never_goes_off_by_it() -> None:
    line, one = CLASSIC.new(), frame(1, b"\x01")
    CLASSIC.failing(line, B, 32)
    lines.put(line, A, one, int(line.free_at))
    found = events(line, int(line.free_at) + 40_000)
    whats = [what for what, *_ in found]
    assert whats.count(Outcome.SENT) == 1 and whats[-1] == Outcome.SENT, "once B is back"
    back = whats.index(Outcome.RECOVERED)
    assert set(whats[:back]) == {Outcome.ERROR} and back > 16
    assert line.worst[A] == 128 and line.times_off[A] == 0
    slot = CLASSIC.ticks(one) - 3 - 9
    first, second = (at for _, at, _ in found[:2])
    assert second - first == 6 + 8 + 3 + slot + 1, "flag, delimiter, intermission, to the slot"


@both
def test_who_has_only_errors_goes_bus_off_and_its_frame_is_lost(kind: Kind) -> None:
    line = kind.new(p=1.0)
    lines.put(line, A, kind.frame(1, kind.longest), 0)
    found = events(line, 100_000)
    assert [what for what, *_ in found[:32]] == [Outcome.ERROR] * 31 + [Outcome.BUS_OFF]
    assert lines.state_of(line, A) in (SenderState.OFF, SenderState.ACTIVE)
    assert (line.lost_off[A], line.sent[A]) == (1, 0)


# --------------------------------------------------------------------------------------- chance


def drawn(
    kind: Kind, seed: int, p: float, burst: float, frames: int
) -> tuple[list[tuple[int, int, int]], Any]:
    """Return the events of mixed frames of two senders under errors, and their line."""
    draw, line, found = random.Random(5), kind.new(p=p, burst=burst, seed=seed), []
    for k in range(frames):
        lines.put(line, k % 2, kind.mixed(draw), kind.slot * k)
        found += events(line, kind.slot * (k + 1))
    return found, line


@both
def test_equal_seeds_give_equal_events_and_others_do_not(kind: Kind) -> None:
    (once, line), (again, other) = (drawn(kind, 1, 1e-3, 2.0, 1000) for _ in range(2))
    assert once == again and line.tobytes() == other.tobytes()
    assert drawn(kind, 2, 1e-3, 2.0, 1000)[0] != once


def both_drawn() -> list[list[tuple[int, int, int]]]:
    return [drawn(kind, 1, p, 2.0, 100)[0] for kind, p in ((CLASSIC, 4e-3), (FD, 1e-3))]


def test_interpreted_it_gives_the_same_events() -> None:
    found = both_drawn()
    assert interpreted(__name__, "t.both_drawn()") == str(found)
    for one in found:
        assert {what for what, *_ in one} >= {Outcome.SENT, Outcome.ERROR} and len(one) > 115


@pytest.mark.parametrize(
    ("kind", "p"), [(CLASSIC, 1e-5), (CLASSIC, 1e-4), (CLASSIC, 1e-3), (FD, 1e-5), (FD, 1e-4)]
)
def test_as_many_frames_are_hit_as_bits_are(kind: Kind, p: float) -> None:
    line, n, one = kind.new(p=p, seed=3), 3000, kind.frame(1, kind.longest)
    for k in range(n):
        lines.put(line, k % 2, one, kind.slot * k)
        events(line, kind.slot * (k + 1))
    each = 1.0 - (1.0 - p) ** (len(kind.lasting(one)) - 1)
    runs = n / (1.0 - each)
    errors = int(line.errors.sum())
    assert abs(errors - runs * each) < 4.0 * math.sqrt(runs * each) + 1.0, f"{errors}"


@both
def test_a_hit_that_is_drawn_ends_its_frame_at_the_end_of_that_bit(kind: Kind) -> None:
    draw, hits = random.Random(4), set()
    line = kind.new(p=4e-3, seed=9)
    for _ in range(120):
        begin = int(line.free_at)
        one = kind.frame(1, draw.randbytes(len(kind.longest) // 2))
        line.transmit_errors[A] = line.waiting[A] = line.not_before[A] = 0
        lines.put(line, A, one, begin)
        assert lines.advance(line, begin + 1) == Outcome.NOTHING
        if line.hit >= 0:
            assert line.due == begin + sum(kind.lasting(one)[: line.hit + 1]), f"hit {line.hit}"
            hits.add(int(line.hit))
        lines.advance(line, int(line.due))
    assert len(hits) > 20


@both
def test_a_burst_hits_as_many_transmissions_in_a_row_as_it_says(kind: Kind) -> None:
    whats = [what for what, *_ in drawn(kind, 4, 1e-4, 4.0, 3000)[0]]
    runs = [len(list(group)) for hit, group in itertools.groupby(whats, Outcome.SENT.__ne__) if hit]
    mean = sum(runs) / len(runs)
    assert abs(mean - 4.0) < 4.0 * math.sqrt(12.0 / len(runs)), f"{mean} in {len(runs)} bursts"
