"""CAN FD on the line: times at two bit rates, mixed frames, error flags, bounds, bus off."""

import itertools
import math
import os
import random
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from test_fd_stuffing import Stream, fd_frame, stream
from test_frame_bits import FD_LENGTHS, classic_frame, fd_bits
from test_line import A, Arrival, B, C, events, failing, frame, new

from pcpc.drivers.can import line as lines
from pcpc.drivers.can.line import Condition, Outcome
from pcpc.drivers.compiled.rows import CLASSIC_BYTES, FRAME_BYTES, Flag
from pcpc.tools.start.bus.response import Message, responses_ns

BIT, FAST = 5, 1  # ticks
RATES = {"bitrate": 1_000_000, "data_bitrate": 5_000_000}
BRS, ESI = Flag.BRS, Flag.ESI
Bytes = NDArray[np.uint8]


def of_frame(one: Bytes) -> Stream:
    word = int.from_bytes(one[:4].tobytes(), "little")
    data = one[8 : 8 + one[4]].tobytes()
    return stream(word & 0x1FFFFFFF, data, word >> 31 == 1, int(one[5]))


def ticks(one: Bytes) -> int:
    """Return how long a frame and its intermission take, of the encoders of lists and strings."""
    if not one[5] & Flag.FD:
        word = int.from_bytes(one[:4].tobytes(), "little")
        data = one[8 : 8 + one[4]].tobytes()
        return BIT * classic_frame(word & 0x1FFFFFFF, word >> 31 == 1, data)
    return sum(of_frame(one).ticks(BIT, FAST)) + 3 * BIT


def sent(line: Any, arrivals: list[Arrival], until: int) -> list[tuple[bytes, int]]:
    """Return the frames that come through, in order, each with the ticks that it took."""
    found = []
    for at, group in itertools.groupby(
        [*sorted(arrivals, key=lambda a: a[:2]), (until, -1, frame(0))], key=lambda a: a[0]
    ):
        while (what := lines.advance(line, at)) != Outcome.NOTHING:
            if what == Outcome.SENT:
                n = FRAME_BYTES if line.frame[5] & Flag.FD else CLASSIC_BYTES
                found.append((line.frame[:n].tobytes(), int(line.waited)))
        for _, s, one in group:
            if s >= 0:
                assert lines.put(line, s, one, at)
    return found


# ------------------------------------------------------------------------------------ two bit rates


@pytest.mark.parametrize("flags", [0, BRS], ids=["nominal", "switched"])
@pytest.mark.parametrize("n", FD_LENGTHS)
def test_a_frame_takes_the_time_of_its_bits(n: int, flags: int) -> None:
    one = fd_frame(0x123, bytes(range(n)), flags=flags)
    (through,) = sent(new(**RATES), [(7, A, one)], 20_000)
    assert through == (one.tobytes(), ticks(one) - 3 * BIT)
    bits = len(of_frame(one).bits)
    assert flags or through[1] == BIT * bits, "without a switch all bits are nominal"


def test_with_one_bit_rate_a_switch_changes_no_time() -> None:
    for flags in (0, BRS):
        one = fd_frame(0x123, bytes(64), flags=flags)
        ((_, waited),) = sent(new(), [(0, A, one)], 2000)
        assert waited == len(of_frame(one).bits)


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


def mixed(draw: random.Random) -> Bytes:
    extended = draw.random() < 0.3
    can_id = draw.getrandbits(29 if extended else 11)
    if draw.random() < 0.4:
        return frame(can_id, draw.randbytes(draw.randrange(9)), extended)
    data = bytes(draw.choices([0, 255, 0x5A, draw.getrandbits(8)], k=draw.choice(FD_LENGTHS)))
    return fd_frame(can_id, data, extended, draw.choice([0, BRS, BRS]))


def test_classic_and_fd_frames_share_the_line_by_their_ids_and_none_changes() -> None:
    draw = random.Random(1)
    for _ in range(20):
        frames = [mixed(draw) for _ in range(12)]
        through = sent(new(3, **RATES), [(0, draw.randrange(3), one) for one in frames], 100_000)
        order = sorted(frames, key=lambda one: int(lines.urgency_of(one)))
        assert [raw for raw, _ in through] == [one.tobytes() for one in order]
        ends = np.cumsum([ticks(one) for one in order]) - 3 * BIT
        assert [waited for _, waited in through] == ends.tolist()


def test_a_passive_sender_says_so_in_its_fd_frames_alone() -> None:
    line = new(**RATES)
    line.transmit_errors[A] = 200
    arrivals = [(0, A, fd_frame(1, b"\1")), (0, A, frame(2, b"\2")), (0, B, fd_frame(3, b"\3"))]
    through = dict.fromkeys(raw[0] for raw, _ in sent(line, arrivals, 20_000))
    flags = {raw[0]: raw[5] for raw, _ in sent(_passive(), arrivals, 20_000)}
    assert list(through) == [1, 3, 2]
    assert flags == {1: Flag.FD | BRS | ESI, 2: 0, 3: Flag.FD | BRS}


def _passive() -> Any:
    line = new(**RATES)
    line.transmit_errors[A] = 200
    return line


def test_a_passive_sender_lets_the_others_go_first_for_eight_nominal_bits() -> None:
    ones = [fd_frame(1, b"\1", flags=BRS | ESI), fd_frame(2, b"\2", flags=BRS | ESI)]
    through = sent(_passive(), [(0, A, one) for one in ones], 20_000)
    assert through[1][1] == ticks(ones[0]) + 8 * BIT + ticks(ones[1]) - 3 * BIT
    line = _passive()
    lines.put(line, A, ones[0], 0)
    assert lines.advance(line, 1) == Outcome.NOTHING
    line.hit, line.due = 0, BIT
    assert events(line, BIT) == [(Outcome.ERROR, BIT, A)]
    assert lines.next_due(line) == int(line.free_at) + 8 * BIT + 1


# ------------------------------------------------------------------------------------- error flags


def idle_at(one: Stream, hit: int, passive: bool) -> int:
    """Return the tick at which the line is idle again: a sender and a receiver, each on its clock.

    The receiver reads what the sender's flag leaves on the line at the bit rate that it believes
    in, and judges all that it has read anew with each bit.
    """
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
def test_an_error_frame_is_as_long_as_two_controllers_make_it(passive: bool) -> None:
    draw = random.Random(1)
    for _ in range(40):
        data = bytes(draw.choices([0, 255, 0x5A], k=draw.choice(FD_LENGTHS[:12])))
        one = fd_frame(draw.getrandbits(11), data, flags=draw.choice([0, BRS]))
        with_esi = one.copy()
        with_esi[5] |= ESI if passive else 0
        made = of_frame(with_esi)
        for hit in range(len(made.bits) - 1):
            line = new(**RATES)
            for s in (A, B):
                line.transmit_errors[s] = 128 if passive else 0
            lines.put(line, A, one, 0)
            assert lines.advance(line, 1) == Outcome.NOTHING, "it has begun"
            due = sum(made.ticks(BIT, FAST)[: hit + 1])
            line.hit, line.due = hit, due
            assert events(line, due) == [(Outcome.ERROR, due, A)]
            expected = idle_at(made, hit, passive)
            assert line.free_at == expected, f"hit {hit} of {made}"
            assert line.busy == expected <= due + 23 * BIT


def test_the_frame_comes_again_after_an_error_in_its_data_phase() -> None:
    one = fd_frame(0x123, bytes(range(48)))
    line = new(**RATES)
    lines.put(line, A, one, 0)
    lines.advance(line, 1)
    line.hit, line.due = 300, sum(of_frame(one).ticks(BIT, FAST)[:301])
    assert [what for what, *_ in events(line, line.due)] == [Outcome.ERROR]
    again = int(line.free_at)
    assert events(line, 100_000) == [(Outcome.SENT, again + ticks(one) - 3 * BIT, A)]
    assert (line.errors[A], line.sent[A], line.receive_errors[B]) == (1, 1, 0)
    assert line.frame.tobytes() == one.tobytes()


def test_bus_off_and_recovery_count_nominal_bits() -> None:
    line = new(**RATES)
    (*_, (what, _, who)) = failing(line, A, 32)
    assert (what, who) == (Outcome.BUS_OFF, A)
    assert not lines.put(line, A, fd_frame(5, b""), int(line.free_at))
    delimiter = int(line.free_at) - 11 * BIT
    due = delimiter + 128 * 11 * BIT
    assert lines.next_due(line) == due
    assert events(line, due - 1) == []
    assert events(line, due) == [(Outcome.RECOVERED, due, A)]


def test_between_frames_of_others_there_is_one_run_of_recessive_bits_each() -> None:
    line = new(3, room=256, **RATES)
    failing(line, A, 32)
    begin, one = int(line.free_at), fd_frame(7, b"\x12\x34")
    for _ in range(200):
        lines.put(line, B, one, begin)
    found = events(line, begin + 200 * ticks(one))
    assert [what for what, *_ in found].index(Outcome.RECOVERED) == 127


def test_a_hit_that_is_drawn_ends_its_frame_at_the_end_of_that_bit() -> None:
    draw, hits = random.Random(4), set()
    line = new(p=4e-3, seed=9, **RATES)
    for _ in range(60):
        begin, one = int(line.free_at), fd_frame(1, draw.randbytes(32))
        line.transmit_errors[A] = line.waiting[A] = line.not_before[A] = 0
        lines.put(line, A, one, begin)
        assert lines.advance(line, begin + 1) == Outcome.NOTHING
        if line.hit >= 0:
            passed = sum(of_frame(one).ticks(BIT, FAST)[: line.hit + 1])
            assert line.due == begin + passed, f"hit {line.hit}"
            hits.add(int(line.hit))
        lines.advance(line, int(line.due))
    assert len(hits) > 20


def test_an_fd_sender_goes_bus_off_and_its_frames_are_lost() -> None:
    line = new(p=1.0, **RATES)
    lines.put(line, A, fd_frame(1, bytes(64)), 0)
    found = events(line, 100_000)
    assert [what for what, *_ in found[:32]] == [Outcome.ERROR] * 31 + [Outcome.BUS_OFF]
    assert lines.state_of(line, A) in (Condition.OFF, Condition.ACTIVE)
    assert (line.lost_off[A], line.sent[A]) == (1, 0)


@pytest.mark.parametrize("p", [1e-5, 1e-4])
def test_as_many_frames_are_hit_as_bits_are(p: float) -> None:
    line, n = new(p=p, seed=3, **RATES), 2000
    one = fd_frame(1, bytes(range(64)))
    for k in range(n):
        lines.put(line, k % 2, one, 2000 * k)
        events(line, 2000 * (k + 1))
    each = 1.0 - (1.0 - p) ** (len(of_frame(one).bits) - 1)
    runs = n / (1.0 - each)
    errors = int(line.errors.sum())
    assert abs(errors - runs * each) < 4.0 * math.sqrt(runs * each) + 1.0, f"{errors}"


def drawn(p: float, n: int) -> list[tuple[int, int, int]]:
    """Return the events of mixed frames of two senders under errors."""
    draw, line, found = random.Random(5), new(p=p, burst=2.0, seed=1, **RATES), []
    for k in range(n):
        lines.put(line, k % 2, mixed(draw), 4000 * k)
        found += events(line, 4000 * (k + 1))
    return found


def test_interpreted_it_gives_the_same_events() -> None:
    code = "from test_line_fd import drawn; print(drawn(1e-3, 60))"
    paths = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[2])])
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": paths},
    )
    found = drawn(1e-3, 60)
    assert done.stdout.strip() == str(found)
    assert {what for what, *_ in found} == {Outcome.SENT, Outcome.ERROR}


# ------------------------------------------------------------------------------------------- bounds


def traffic(draw: random.Random) -> list[tuple[Message, Bytes]]:
    """Return classic and FD frames by priority, with their real times in ticks."""
    while True:
        found, ids = [], sorted(draw.sample(range(2048), draw.randint(2, 8)))
        for can_id in ids:
            one = mixed(draw).copy()
            one[:4] = list(can_id.to_bytes(4, "little"))
            found.append(
                (Message(ticks(one), draw.choice([2500, 3500, 5000, 10_000, 15_500])), one)
            )
        if 0.3 < math.fsum(k.transmission_ns / k.period_ns for k, _ in found) < 0.97:
            return found


@pytest.mark.parametrize("seed", range(20))
def test_no_frame_takes_longer_than_the_analysis_says_and_the_bound_is_reached(seed: int) -> None:
    """All come a tick after a lower one has begun: the worst case, within a tick."""
    frames = traffic(random.Random(seed))
    bounds = responses_ns([k for k, _ in frames], 1)
    for m, (bound, (_, own)) in enumerate(zip(bounds, frames, strict=True)):
        lower = max((k for k in frames[m + 1 :]), key=lambda k: k[0].transmission_ns, default=None)
        arrivals = [] if lower is None else [(0, C, lower[1])]
        for k, one in frames[: m + 1]:
            arrivals += [(at, A, one) for at in range(1, 100_000, k.period_ns)]
        through = sent(new(3, room=256, **RATES), arrivals, 150_000)
        most = max(waited for raw, waited in through if raw == own.tobytes()) + 3 * BIT
        assert bound is not None
        assert bound - 1 <= most <= bound, f"frame {m}: {most} ticks, bound {bound}"


def with_most_stuff_bits(n: int) -> Bytes:
    """Return a frame whose data bits are like the bit before: a stuff bit behind each fourth."""
    empty = stream(0x078, bytes(n), False, BRS)
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
    ((_, waited),) = sent(new(**RATES), [(0, A, one)], 5000)
    short = BIT * nominal + FAST * data - (waited + 3 * BIT)
    assert BIT - FAST <= short <= BIT - FAST + 3 * FAST, f"{short} ticks"
