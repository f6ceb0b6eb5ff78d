"""Senders of another bit rate on the CAN line: what each finds wrong, counters, who hears whom."""

from typing import Any

import pytest
from line_kinds import CLASSIC, FD, A, B, C, Kind, both, events, new
from second_encoder import frame, stream

from pcpc.drivers.line import line as lines
from pcpc.drivers.line.line import Outcome, SenderState

RATE = 1_000_000
PAIRS = [(RATE, RATE // 2), (RATE // 2, RATE), (RATE, 125_000), (500_000, 800_000)]


def of_rates(sender: int, receiver: int, senders: int = 2, **options: Any) -> Any:
    """Return a line at the sender's bit rate, on which B has another one."""
    return new(senders, bitrate=sender, others={B: receiver}, **options)


def found_wrong(bits: str, sender: int, receiver: int) -> int:
    """Return the bit in which a receiver has read six equal ones, by their times in seconds."""
    read, k = "", 0
    while (at := int((k + 0.75) * sender / receiver)) < len(bits) - 9:
        read, k = read + bits[at], k + 1
        if read[-6:] in ("000000", "111111"):
            return at
    return len(bits) - 9  # the ACK slot


@pytest.mark.parametrize(("sender", "receiver"), PAIRS)
@pytest.mark.parametrize("can_id", [0x000, 0x2AA, 0x555, 0x7FF])
def test_who_has_another_bit_rate_flags_the_sixth_equal_bit_that_it_reads(
    sender: int, receiver: int, can_id: int
) -> None:
    one, line = frame(can_id, bytes(range(8))), of_rates(sender, receiver)
    lines.put(line, A, one, 0)
    assert lines.advance(line, 1) == Outcome.NOTHING
    hit = found_wrong(stream(one).bits, sender, receiver)
    assert (line.hit, line.due) == (hit, (hit + 1) * line.own_bit[A])


@both
def test_both_ends_are_passive_or_off_within_a_hundredth_of_a_second_and_nothing_comes_through(
    kind: Kind,
) -> None:
    rates = kind.rates or {"bitrate": RATE}
    line = new(2, **rates, others={B: RATE // 2})
    for tick in range(0, until := int(line.per_s) // 10, until // 100):
        for s in (A, B):
            lines.put(line, s, kind.frame(s + 1, b"\1"), tick)
        whats = [what for what, *_ in events(line, tick)]
        assert Outcome.SENT not in whats and (tick == 0 or Outcome.ERROR in whats)
        if tick >= until // 10:
            states = [lines.state_of(line, s) for s in (A, B)]
            assert min(states) >= SenderState.PASSIVE, states
    assert line.sent.sum() == 0


def test_who_flags_and_does_not_send_takes_the_other_off_the_bus() -> None:
    line = of_rates(RATE, RATE // 2)
    lines.put(line, A, frame(1, b"\1"), 0)
    whats = [what for what, *_ in events(line, 20_000)]
    assert whats[:32] == [Outcome.ERROR] * 31 + [Outcome.BUS_OFF], "8 for each of 32 flags"
    assert (line.times_off[A], line.lost_off[A]) == (1, 1) and line.receive_errors[B] == 32


def test_among_three_the_odd_one_spoils_frames_until_it_is_passive_and_then_hears_nothing() -> None:
    line = new(3, bitrate=RATE, others={B: RATE // 2})
    line.receive_errors[B] = 127
    lines.put(line, A, frame(1, b"\1"), 0)
    whats = [what for what, *_ in events(line, 1000)]
    assert whats == [Outcome.ERROR, Outcome.SENT]
    assert (line.transmit_errors[A], line.receive_errors[B], line.receive_errors[C]) == (7, 129, 0)
    assert [lines.hears(line, s) for s in (A, B, C)] == [True, False, True]


def test_an_odd_sender_is_acknowledged_by_nobody_and_its_bits_last_as_long_as_it_says() -> None:
    line = new(3, bitrate=RATE, others={B: RATE // 4})
    line.receive_errors[A] = line.receive_errors[C] = 200  # passive: they flag nothing
    one = frame(0x123, b"\x55")
    lines.put(line, B, one, 0)
    ((what, at, who), *_) = events(line, 4 * len(stream(one).bits) + 1)
    assert (what, who) == (Outcome.ERROR, B)
    assert at == 4 * (len(stream(one).bits) - 8), "the end of the ACK slot"


def test_equal_rates_are_no_mismatch() -> None:
    one, made = CLASSIC.frame(5, b"\1\2"), []
    for others in ({}, {B: RATE}):
        line = new(2, bitrate=RATE, others=others)
        lines.put(line, A, one, 3)
        made.append((events(line, 5000), line.tobytes()))
    assert made[0] == made[1]
    with pytest.raises(ValueError, match="no common tick"):
        new(2, **FD.rates, others={B: 999_983})
