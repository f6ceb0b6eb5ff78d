"""The SDO server against CiA 301's frames: values, texts, segments, abort codes."""

from dataclasses import replace
from typing import Any

import pytest
from drives import NODE, Bench

from pcpc.drivers.canopen import dictionary as why
from pcpc.drivers.canopen import objects as objects_of
from pcpc.drivers.canopen.layout import READ, WRITE, Mistake, ObjectType, Od
from pcpc.drivers.canopen.objects import Object, objects

EVERY = objects(NODE, "bench")
NUMBERS = [one for one in EVERY if one.kind != ObjectType.TEXT]


def segments(bench: Bench, index: int) -> bytes:
    head = bench.sdo(bytes([0x40, index & 255, index >> 8, 0]))
    assert head[0] == 0x41
    length, got, toggle = int.from_bytes(head[4:8], "little"), b"", 0
    while True:
        answer = bench.sdo(bytes([0x60 | toggle << 4]))
        assert answer[0] >> 4 & 1 == toggle and answer[0] >> 5 == 0
        got += answer[1 : 8 - (answer[0] >> 1 & 7)]
        toggle = 1 - toggle
        assert bool(answer[0] & 1) == (len(got) == length), "the last is marked"
        if answer[0] & 1:
            return got


def test_every_object_is_read_with_its_value_and_size() -> None:
    bench = Bench()
    for one in EVERY:
        if one.kind == ObjectType.TEXT:
            assert segments(bench, one.index).decode() == one.text
            continue
        answer = bench.sdo(bytes([0x40, one.index & 255, one.index >> 8, one.subindex]))
        size = 4 - (answer[0] >> 2 & 3)
        assert answer[0] & 0xE3 == 0x43 and 8 * size == one.bits, one
        if one.index < 0x1F80 and one.index != 0x1001:
            want = one.start & (1 << one.bits) - 1
            assert int.from_bytes(answer[4 : 4 + size], "little") == want, one


@pytest.mark.parametrize("one", NUMBERS, ids=[one.key for one in NUMBERS])
def test_a_write_is_taken_or_refused_for_its_reason(one: Object) -> None:
    bench, size = Bench(), one.bits // 8
    low, high = one.bounds
    write = lambda value: bench.write(one.index, one.subindex, value, size)  # noqa: E731
    if not one.access & WRITE:
        assert write(one.start) == why.READ_ONLY
        return
    if one.index not in range(0x1400, 0x1C00):
        assert write(one.start) == 0
    raw_low, raw_high = (-(1 << one.bits - 1), (1 << one.bits - 1) - 1) if one.signed else (
        0, (1 << one.bits) - 1)  # fmt: skip
    if high < raw_high:
        assert write(high + 1) == why.TOO_HIGH
    if low > raw_low:
        assert write(low - 1) == why.TOO_LOW
    wrong = bench.sdo(bytes([0x23 | (4 - (size % 4 + 1)) << 2, one.index & 255, one.index >> 8,
                             one.subindex]))  # fmt: skip
    assert int.from_bytes(wrong[4:8], "little") == why.WRONG_LENGTH


def changed_bench(index: int, **about: Any) -> Bench:
    """Return a bench one of whose objects is another one."""
    bench = Bench()
    every = [replace(one, **about) if one.index == index else one for one in EVERY]
    objects_of.install(bench.d, NODE, every)
    return bench


@pytest.mark.parametrize("length", [1, 7, 8, 14, 32])
def test_a_text_of_any_length_has_no_segment_too_many(length: int) -> None:
    bench = changed_bench(0x1008, text="x" * length)
    assert segments(bench, 0x1008) == b"x" * length


def test_what_may_only_be_written_is_not_read() -> None:
    assert changed_bench(0x1017, access=WRITE).read(0x1017) == -why.WRITE_ONLY


# Block upload and download of CiA 301 with and without a CRC: their begins, then what follows one.
BLOCKS = [0xA0, 0xA4, 0xA1, 0xA2, 0xA3, 0xC0, 0xC2, 0xC4, 0xC6, 0xC1, 0xDD]


@pytest.mark.parametrize("command", [*BLOCKS, 0xE0, 0xFF])
@pytest.mark.parametrize("key", [(0x1008, 0), (0x1018, 3), (0x1017, 0), (0x2000, 7)])
def test_a_block_transfer_is_no_command_and_changes_nothing(
    command: int, key: tuple[int, int]
) -> None:
    bench, head = Bench(), bytes([key[0] & 255, key[0] >> 8, key[1]])
    before = bench.d.value.tobytes()
    answer = bench.sdo(bytes([command]) + head + bytes([127, 0, 0, 0]))
    assert answer == bytes([0x80]) + head + (0x0504_0001).to_bytes(4, "little")
    assert bench.d.value.tobytes() == before and bench.d.mistakes[Mistake.SDO_ABORTED] == 1
    assert segments(bench, 0x1008) == b"bench", "the next transfer begins anew"


@pytest.mark.parametrize("command", BLOCKS)
def test_a_block_ends_the_transfer_that_was_under_way(command: int) -> None:
    bench = Bench()
    bench.sdo(bytes([0x40, 8, 0x10, 0]))
    assert bench.sdo(bytes([command, 8, 0x10, 0]))[0] == 0x80
    assert bench.sdo(bytes([0x60]))[4:] == why.NO_COMMAND.to_bytes(4, "little")


def test_what_is_not_there_is_told_apart_from_a_subindex_that_is_not() -> None:
    bench = Bench()
    assert bench.read(0x2000) == -why.NO_OBJECT
    assert bench.read(0x1018, 9) == -why.NO_SUBINDEX
    assert bench.write(0x100C, 0, 100, 2) == why.NO_OBJECT  # node guarding
    assert bench.write(0x60B8, 0, 1, 2) == why.NO_OBJECT  # touch probe


@pytest.mark.parametrize("mode", [2, 4, 5, 7, 11, -1])
def test_a_mode_that_is_not_there_is_refused(mode: int) -> None:
    assert Bench().write(0x6060, 0, mode, 1) == why.WRONG_VALUE


def test_a_value_is_written_in_segments() -> None:
    bench = Bench()
    assert bench.sdo(bytes([0x21, 0x7A, 0x60, 0, 4, 0, 0, 0]))[0] == 0x60
    assert bench.sdo(bytes([0x00 | 4 << 1, 1, 2, 3]))[0] == 0x20
    assert bench.sdo(bytes([0x10 | 6 << 1 | 1, 4]))[0] == 0x30
    assert bench[Od.TARGET_POSITION] == 0x04030201


def test_segments_want_their_toggle_a_transfer_and_the_length() -> None:
    bench = Bench()
    code = lambda answer: int.from_bytes(answer[4:], "little")  # noqa: E731
    assert code(bench.sdo(bytes([0x60]))) == why.NO_COMMAND
    assert code(bench.sdo(bytes([0x00]))) == why.NO_COMMAND
    bench.sdo(bytes([0x40, 8, 0x10, 0]))
    assert code(bench.sdo(bytes([0x70]))) == why.TOGGLE
    assert code(bench.sdo(bytes([0x60]))) == why.NO_COMMAND, "the transfer is over"
    bench.sdo(bytes([0x20, 0x7A, 0x60, 0]))
    assert code(bench.sdo(bytes([0x10, 1]))) == why.TOGGLE
    bench.sdo(bytes([0x20, 0x7A, 0x60, 0]))
    assert code(bench.sdo(bytes([5 << 1 | 1, 1, 2]))) == why.WRONG_LENGTH, "2 bytes of 4"
    bench.sdo(bytes([0x20, 0x7A, 0x60, 0]))
    assert code(bench.sdo(bytes([0x01, 1, 2, 3, 4, 5, 6, 7]))) == why.WRONG_LENGTH
    assert code(bench.sdo(bytes([0x21, 0x7A, 0x60, 0, 3, 0, 0, 0]))) == why.WRONG_LENGTH


@pytest.mark.parametrize(
    ("begin", "segment"), [((0x40, 8, 0x10), 0x00), ((0x20, 0x7A, 0x60), 0x60)]
)
def test_a_segment_of_the_other_direction_is_no_command(
    begin: tuple[int, ...], segment: int
) -> None:
    bench = Bench()
    assert bench.sdo(bytes(begin))[0] in (0x41, 0x60)
    answer = bench.sdo(bytes([segment]))
    assert (answer[0], answer[4:]) == (0x80, why.NO_COMMAND.to_bytes(4, "little"))


def test_a_client_that_falls_silent_is_given_up_after_a_second() -> None:
    bench = Bench()
    bench.sdo(bytes([0x40, 8, 0x10, 0]))
    bench.cycles(1000)
    assert not [one for one in bench.sent(0x585) if one.data[0] == 0x80]
    bench.cycles(2)
    last = bench.sent(0x585)[-1].data
    assert last == bytes([0x80, 8, 0x10, 0]) + why.TIMED_OUT.to_bytes(4, "little")


def test_a_client_that_goes_on_within_a_second_is_never_given_up() -> None:
    bench = changed_bench(0x1008, text="x" * 32)
    bench.sdo(bytes([0x40, 8, 0x10, 0]))
    for i in range(5):
        bench.d.k += 699
        bench.cycles(1)
        assert bench.sdo(bytes([0x60 | i % 2 << 4]))[0] >> 5 == 0
    bench.sdo(bytes([0x20, 0x7A, 0x60, 0]))
    for i in range(4):
        bench.d.k += 699
        bench.cycles(1)
        assert bench.sdo(bytes([i % 2 << 4 | 6 << 1 | i // 3, 1]))[0] == 0x20 | i % 2 << 4
    assert bench[Od.TARGET_POSITION] == 0x01010101


def test_a_frame_that_is_no_sdo_has_no_answer() -> None:
    bench = Bench()
    assert bench.send(0x605, b"\x40\x00\x10") == []
    assert bench.send(0x606, bytes(8)) == []
    bench.send(0, bytes([2, 5]))
    assert bench.send(0x605, bytes([0x40, 0, 0x10, 0, 0, 0, 0, 0])) == [], "stopped"


def test_every_row_has_one_object() -> None:
    keys = [one.key for one in EVERY]
    assert len(set(keys)) == len(keys) <= 256
    assert all(one.access & READ for one in EVERY)
    assert [one.name for one in EVERY[-len(Od) :]] == [
        row.name.replace("_", " ").capitalize() for row in Od
    ]
