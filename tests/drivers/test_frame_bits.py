"""The longest frames: published lengths, and the search for the longest."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from second_encoder import FD_LENGTHS, fd_frame, frame, stream

from pcpc.drivers.can.frame_bits import UNSTUFFED, classic_bits, fd_bits, transmission_ns

CRC15 = 0x4599
FREE = None  # a bit that may be either
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


def classic_frame(can_id: int, extended: bool, data: bytes) -> int:
    """Return the bits of a classic frame on the wire, interframe space included."""
    return len(stream(frame(can_id, data, extended)).bits) + 3


def test_real_frames_are_built_as_the_standard_says() -> None:
    data = bytes.fromhex("55" * 8)  # bits that change each time: only the classic CRC is stuffed
    assert classic_frame(0x555, False, data) == 47 + 64 + 1
    assert classic_frame(0, False, b"") == 47 + 6, "34 zeros, CRC included"
    fd = stream(fd_frame(0x555, data))
    assert (len(fd.head), len(fd.body + fd.check) - len(fd.head)) == (17, 5 + 64 + 27)


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
    return [*begin, *([0, 0] if extended else [0]), *map(int, f"{n:04b}"), *[FREE] * (8 * n)]


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
    code = map(int, f"{FD_LENGTHS.index(n):04b}")
    head = [0, *[FREE] * 11, *([1, 1, *[FREE] * 18, 0] if extended else [0, 0]), 1, 0]
    stuff = most_stuff_bits([*head, 1, 0, *code, *[FREE] * (8 * n)])
    unstuffed = len(head) + 2 + 4 + 8 * n + (27 if n <= 16 else 32) + UNSTUFFED
    assert sum(fd_bits(n, extended)) - unstuffed - stuff == less
    nominal = len(head) + 1 + most_stuff_bits(head) + UNSTUFFED
    assert fd_bits(n, extended)[0] - nominal == nominal_less
