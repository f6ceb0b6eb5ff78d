"""The longest frames: published lengths, real frames bit by bit, and the search for the longest."""

import random
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pcpc.drivers.can.frame_bits import UNSTUFFED, classic_bits, fd_bits, transmission_ns
from pcpc.drivers.line.stuffing import RAW_BITS, WIRE_BITS, encode

CRC15 = 0x4599
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
FREE = None  # a bit that may be either
Bits = list[int]
Pattern = Sequence[int | None]


@pytest.mark.parametrize(("n", "bits"), [(8, 135), (7, 125), (4, 95), (2, 75), (1, 65), (0, 55)])
def test_a_classic_frame_has_the_published_length(n: int, bits: int) -> None:
    assert classic_bits(n) == bits
    assert classic_bits(n, extended=True) == bits + 25


@pytest.mark.parametrize(
    ("n", "bits", "extended"), [(0, 67, 91), (8, 147, 171), (16, 227, 251), (64, 712, 736)]
)
def test_an_fd_frame_has_the_length_that_linux_computes(n: int, bits: int, extended: int) -> None:
    assert sum(fd_bits(n)) == bits
    assert sum(fd_bits(n, extended=True)) == extended


def test_the_time_of_a_frame_is_that_of_its_phases() -> None:
    assert transmission_ns(7, False, 125e3, None) == 1_000_000
    nominal, data = fd_bits(8)
    assert transmission_ns(8, False, 500e3, 2e6) == nominal * 2000 + data * 500
    assert transmission_ns(8, False, 1e6, 1e6) == 1000 * (nominal + data)
    assert transmission_ns(0, False, 3e6, None) == 18_334, "55 bits are 18333.3 ns: rounded up"


# -------------------------------------------------------------------------- real frames, bit by bit


def number(value: int, bits: int) -> Bits:
    return [value >> i & 1 for i in reversed(range(bits))]


def of_bytes(data: bytes) -> Bits:
    return [bit for byte in data for bit in number(byte, 8)]


def crc15(bits: Bits) -> int:
    register = 0
    for bit in bits:
        feedback = bit ^ register >> 14
        register = register << 1 & 0x7FFF ^ (CRC15 if feedback else 0)
    return register


def stuffed(bits: Bits) -> Bits:
    """Return the bits with one of the other kind behind five equal ones."""
    wire: Bits = []
    run = 0
    for bit in bits:
        run = run + 1 if wire and wire[-1] == bit else 1
        wire.append(bit)
        if run == 5:
            wire.append(1 - bit)
            run = 1
    return wire


def arbitration(can_id: int, extended: bool) -> Bits:
    """Return SOF to IDE, or with a 29-bit id to RTR."""
    if extended:
        return [0, *number(can_id >> 18, 11), 1, 1, *number(can_id & 0x3FFFF, 18), 0]
    return [0, *number(can_id, 11), 0, 0]


def classic_stream(can_id: int, extended: bool, data: bytes) -> Bits:
    """Return the bits of a classic frame, SOF to EOF."""
    head = [*arbitration(can_id, extended), 0, *([0] if extended else [])]
    body = [*head, *number(len(data), 4), *of_bytes(data)]
    return [*stuffed([*body, *number(crc15(body), 15)]), 1, 0, 1, *[1] * 7]


def classic_frame(can_id: int, extended: bool, data: bytes) -> int:
    """Return the bits of a classic frame on the wire, interframe space included."""
    return len(classic_stream(can_id, extended, data)) + 3


def fd_frame(can_id: int, extended: bool, data: bytes) -> tuple[int, int]:
    """Return the bits of an FD frame with BRS in its two phases; its CRC need not be known."""
    head = [*arbitration(can_id, extended), 1, 0]  # FDF, res; then BRS, ESI
    body = [*head, 1, 0, *number(FD_LENGTHS.index(len(data)), 4), *of_bytes(data)]
    checked = 4 + (17 if len(data) <= 16 else 21)  # stuff count and CRC
    fixed = len(range(0, checked, 4))  # a stuff bit before each four of them
    nominal = len(stuffed(head)) + 1
    return nominal + UNSTUFFED, len(stuffed(body)) - nominal + checked + fixed


def test_real_frames_are_built_as_the_standard_says() -> None:
    assert crc15([1]) == CRC15
    data = bytes.fromhex("55" * 8)  # bits that change each time: only the classic CRC is stuffed
    assert classic_frame(0x555, False, data) == 47 + 64 + 1
    assert classic_frame(0, False, b"") == 47 + 6, "34 zeros, CRC included"
    assert fd_frame(0x555, False, data) == (17 + 13, 5 + 64 + 27)


RUNS = st.sampled_from([0x00, 0xFF, 0x78, 0x87, 0x0F, 0xC3])  # bytes that are stuffed often


@given(st.booleans(), st.integers(0, 2**29 - 1), st.lists(RUNS | st.integers(0, 255), max_size=8))
@settings(max_examples=400, deadline=None)
def test_the_bits_on_the_line_are_those_of_an_encoder_of_lists(
    extended: bool, can_id: int, data: list[int]
) -> None:
    can_id &= 0x1FFFFFFF if extended else 0x7FF
    word = can_id | extended << 31
    frame = np.frombuffer(
        word.to_bytes(4, "little") + bytes([len(data), 0, 0, 0, *data]).ljust(12, b"\0"), np.uint8
    )
    wire = np.zeros(WIRE_BITS, np.uint8)
    n = encode(frame, np.zeros(RAW_BITS, np.uint8), wire)
    assert wire[:n].tolist() == classic_stream(can_id, extended, bytes(data))
    assert n + 3 <= classic_bits(len(data), extended)


@pytest.mark.parametrize("extended", [False, True], ids=["11 bit", "29 bit"])
def test_no_real_frame_is_longer_than_the_longest(extended: bool) -> None:
    draw = random.Random(1)
    for _ in range(3000):
        can_id = draw.choice([0, draw.getrandbits(29 if extended else 11)])
        n = draw.randrange(9)
        mask = draw.choice([0x00, 0x78, 0x87, 0xFF])
        data = bytes(draw.choice([mask, 0x0F, 0xC3, draw.getrandbits(8)]) for _ in range(n))
        bits = classic_frame(can_id, extended, data)
        assert bits <= classic_bits(n, extended), f"{can_id:x} {data.hex()}: {bits} bits"
        data = data.ljust(draw.choice([n, 16, 64]), bytes([mask]))
        both, longest = fd_frame(can_id, extended, data), fd_bits(len(data), extended)
        assert both[0] <= longest[0], f"FD {can_id:x}: {both[0]} nominal bits"
        assert sum(both) <= sum(longest), f"FD {can_id:x} {data.hex()}: {sum(both)} bits"
        time, most = (a + b / 8 for a, b in (both, longest))
        assert time <= most, f"FD {can_id:x} {data.hex()}: {time} nominal bit times"


# ------------------------------------------------------------------ the longest of all ids and data


def most_stuff_bits(pattern: Pattern) -> int:
    """Return the most stuff bits of any sequence of bits that fits `pattern`."""
    most = {(1, 0): 0}  # by the last bit on the wire and how many like it stand there
    for wanted in pattern:
        after: dict[tuple[int, int], int] = {}
        for (last, run), count in most.items():
            for bit in (0, 1) if wanted is FREE else (wanted,):
                length = run + 1 if bit == last else 1
                state, added = ((1 - bit, 1), 1) if length == 5 else ((bit, length), 0)
                after[state] = max(after.get(state, 0), count + added)
        most = after
    return max(most.values())


def most_stuff_bits_with_crc(pattern: Pattern) -> int:
    """Return the same for a classic frame, whose 15 bits of CRC follow from the pattern's.

    The state is CRC register, last bit and run: what a longer frame can come to depends on no more.
    """
    never = -99
    registers = np.arange(1 << 15)
    shifted = registers << 1 & 0x7FFF
    after_bit = [np.where(registers >> 14 ^ bit, shifted ^ CRC15, shifted) for bit in (0, 1)]

    def fed(most: NDArray[np.int16], wanted: Sequence[int]) -> NDArray[np.int16]:
        after = np.full_like(most, never)
        for bit in wanted:
            for last in (0, 1):
                for run in range(5):
                    length = run + 1 if bit == last else 1
                    state, added = ((1 - bit, 1), 1) if length == 5 else ((bit, length), 0)
                    came = np.full(1 << 15, never, np.int16)
                    came[after_bit[bit]] = most[last, run] + added
                    np.maximum(after[state], came, out=after[state])
        return after

    most = np.full((2, 5, 1 << 15), never, np.int16)
    most[1, 0, 0] = 0
    for wanted in pattern:
        most = fed(most, (0, 1) if wanted is FREE else (wanted,))
    bits = [registers >> i & 1 for i in reversed(range(15))]
    return max(
        int((most[last, run] + _stuff_bits_after(last, run, bits)).max())
        for last in (0, 1)
        for run in range(1, 5)
    )


def _stuff_bits_after(last: int, run: int, bits: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return the stuff bits of each register's CRC behind `run` bits like `last`."""
    lasts, runs = np.full(1 << 15, last), np.full(1 << 15, run)
    count = np.zeros(1 << 15, np.int64)
    for bit in bits:
        runs = np.where(bit == lasts, runs + 1, 1)
        full = runs == 5
        count += full
        lasts, runs = np.where(full, 1 - bit, bit), np.where(full, 1, runs)
    return count


def classic_pattern(n: int, extended: bool) -> Pattern:
    begin = [0, *[FREE] * 11, *([1, 1, *[FREE] * 18, 0] if extended else [0, 0])]
    return [*begin, *([0, 0] if extended else [0]), *number(n, 4), *[FREE] * (8 * n)]


@pytest.mark.parametrize(
    ("n", "extended", "less"),
    [(0, False, 2), (2, False, 3), (8, False, 2), (0, True, 2), (8, True, 2)],
)
def test_the_longest_classic_frame_of_all_is_little_shorter(
    n: int, extended: bool, less: int
) -> None:
    longest = most_stuff_bits_with_crc(classic_pattern(n, extended))
    published = classic_bits(n, extended) - UNSTUFFED - (54 if extended else 34) - 8 * n
    assert published - longest == less, f"{longest} stuff bits, {published} published"


def test_the_search_finds_what_trying_all_short_frames_finds() -> None:
    tried = max(classic_frame(can_id, False, b"") for can_id in range(1 << 11))
    found = most_stuff_bits_with_crc(classic_pattern(0, False))
    assert tried == 47 + found, f"{tried} bits tried, {found} stuff bits found"


@pytest.mark.parametrize(
    ("n", "extended", "less", "nominal_less"),
    [(0, False, 1, 0), (8, False, 2, 0), (64, False, 2, 0), (0, True, 2, 1), (64, True, 3, 1)],
)
def test_the_longest_fd_frame_of_all_is_little_shorter(
    n: int, extended: bool, less: int, nominal_less: int
) -> None:
    code = number(FD_LENGTHS.index(n), 4)
    head = [0, *[FREE] * 11, *([1, 1, *[FREE] * 18, 0] if extended else [0, 0]), 1, 0]
    stuff = most_stuff_bits([*head, 1, 0, *code, *[FREE] * (8 * n)])
    unstuffed = len(head) + 2 + 4 + 8 * n + (27 if n <= 16 else 32) + UNSTUFFED
    assert sum(fd_bits(n, extended)) - unstuffed - stuff == less
    nominal = len(head) + 1 + most_stuff_bits(head) + UNSTUFFED
    assert fd_bits(n, extended)[0] - nominal == nominal_less
