"""SDO block transfer against CiA 301's frames: what a master may do, and what it may not."""

import pytest
from drives import NODE, Bench

from pcpc.drivers.canopen import dictionary as why
from pcpc.drivers.canopen import objects
from pcpc.drivers.canopen.layout import Heartbeat, Mistake, Row

NAME = "a name of thirty-two bytes, all. "[:32]
TEXT, NUMBER, HEARTBEAT = (0x1008, 0), (0x1018, 3), (0x1017, 0)


@pytest.fixture
def bench() -> Bench:
    """Return a drive whose name fills five segments."""
    made = Bench()
    objects.install(made.d, NODE, objects.objects(NODE, NAME))
    return made.cycles(1)


def crc16(data: bytes) -> int:
    """Return the CRC of XMODEM: 0x31C3 of 123456789."""
    crc = 0
    for bit in (byte >> 7 - i & 1 for byte in data for i in range(8)):
        crc = (crc << 1 ^ (0x1021 if (crc >> 15) ^ bit else 0)) & 0xFFFF
    return crc


def told(bench: Bench, *data: int) -> list[bytes]:
    """Return the answers to a frame."""
    return [one.data for one in bench.send(0x600 + NODE, bytes(data).ljust(8, b"\0"))]


def begin_up(bench: Bench, key: tuple[int, int], size: int = 127, pst: int = 0) -> bytes:
    index, subindex = key
    (answer,) = told(bench, 0xA4, index & 255, index >> 8, subindex, size, pst)
    return answer


def begin_down(bench: Bench, key: tuple[int, int], length: int, crc: bool = True) -> bytes:
    index, subindex = key
    head = 0xC2 | crc << 2, index & 255, index >> 8, subindex
    (answer,) = told(bench, *head, *length.to_bytes(4, "little"))
    return answer


def code_of(answer: bytes) -> int:
    assert answer[0] == 0x80, answer.hex()
    return int.from_bytes(answer[4:8], "little")


def test_the_crc_of_the_test_is_that_of_the_catalogue() -> None:
    assert crc16(b"123456789") == 0x31C3


@pytest.mark.parametrize("size", [1, 2, 3, 5, 127])
def test_a_text_comes_in_blocks_of_the_size_that_is_asked_for(bench: Bench, size: int) -> None:
    assert begin_up(bench, TEXT, size) == bytes([0xC6, 8, 0x10, 0, 32, 0, 0, 0])
    got, answers = b"", told(bench, 0xA3)
    while answers[0][0] & 0x7F <= 127 and answers[0][0] != 0xC1 | 3 << 2:
        assert [one[0] & 0x7F for one in answers] == [*range(1, len(answers) + 1)]
        assert len(answers) == min(size, 5 - len(got) // 7)
        got += b"".join(one[1:] for one in answers)
        assert [one[0] >> 7 for one in answers][-1] == (len(got) >= 32)
        answers = told(bench, 0xA2, len(answers), size)
    (end,) = answers
    assert got[:32] == NAME.encode() and len(got) == 35
    assert int.from_bytes(end[1:3], "little") == crc16(NAME.encode())
    assert told(bench, 0xA1) == [] and bench.d.state.segment_row == 0


def test_what_was_not_acknowledged_comes_again(bench: Bench) -> None:
    begin_up(bench, TEXT, 4)
    first = told(bench, 0xA3)
    again = told(bench, 0xA2, 2, 4)  # the third was lost
    assert [one[1:] for one in again[:2]] == [one[1:] for one in first[2:]]
    assert [one[0] for one in again] == [1, 2, 0x83]
    assert [one[1:] for one in told(bench, 0xA2, 0, 2)] == [one[1:] for one in again[:2]]
    assert told(bench, 0xA2, 2, 127)[0][0] == 0x81
    assert told(bench, 0xA2, 1, 127)[0][0] == 0xC1 | 3 << 2


def test_a_short_object_comes_without_a_block_if_the_master_allows_it(bench: Bench) -> None:
    assert begin_up(bench, NUMBER, pst=4) == bytes([0x43, 0x18, 0x10, 3, 0, 0, 1, 0])
    assert begin_up(bench, NUMBER, pst=3) == bytes([0xC6, 0x18, 0x10, 3, 4, 0, 0, 0])
    assert begin_up(bench, TEXT, pst=32)[0] == 0x41
    assert told(bench, 0x60)[0] == b"\0" + NAME[:7].encode()


def test_without_a_crc_none_is_sent(bench: Bench) -> None:
    assert told(bench, 0xA0, 0x18, 0x10, 3, 9)[0][:5] == bytes([0xC2, 0x18, 0x10, 3, 4])
    assert told(bench, 0xA3) == [bytes([0x81, 0, 0, 1, 0, 0, 0, 0])]
    assert told(bench, 0xA2, 1, 9) == [bytes([0xC1 | 3 << 2, *bytes(7)])]


def test_a_write_is_taken_with_its_crc(bench: Bench) -> None:
    assert begin_down(bench, HEARTBEAT, 2) == bytes([0xA4, 0x17, 0x10, 0, 1, 0, 0, 0])
    assert told(bench, 0x81, 0xF4, 1) == [bytes([0xA2, 1, 1, *bytes(5)])]
    assert bench[Row.HEARTBEAT_MS] == 0, "not before the CRC"
    crc = crc16(b"\xf4\1")
    assert told(bench, 0xC1 | 5 << 2, crc & 255, crc >> 8) == [bytes([0xA1, *bytes(7)])]
    assert bench[Row.HEARTBEAT_MS] == 500


def test_a_segment_out_of_order_has_to_come_again(bench: Bench) -> None:
    begin_down(bench, HEARTBEAT, 2, crc=False)
    for wrong in (0x82, 2, 0, 0xFF, 0x40, 0x23):  # two of them would begin transfers elsewhere
        assert told(bench, wrong, 9, 9) == [bytes([0xA2, 0, 1, *bytes(5)])]
    assert told(bench, 0x81, 7, 0)[0][:2] == b"\xa2\1"
    assert told(bench, 0xC1 | 5 << 2)[0][0] == 0xA1
    assert bench[Row.HEARTBEAT_MS] == 7


def ended(bench: Bench, head: int, *crc: int) -> int:
    begin_down(bench, HEARTBEAT, 2)
    told(bench, 0x81, 0xF4, 1)
    (answer,) = told(bench, head, *crc)
    assert answer[1:4] == b"\x17\x10\0", "of the object"
    return code_of(answer)


def test_what_a_master_does_wrong_is_refused_for_its_reason(bench: Bench) -> None:
    crc = crc16(b"\xf4\1")
    right = crc & 255, crc >> 8
    assert ended(bench, 0xC1 | 5 << 2, right[0] ^ 1, right[1]) == why.WRONG_CRC == 0x05040004
    assert ended(bench, 0xC1 | 5 << 2, right[0], right[1] ^ 128) == why.WRONG_CRC
    assert ended(bench, 0xC1 | 4 << 2, *right) == why.WRONG_LENGTH
    assert ended(bench, 0x60, *right) == why.NO_COMMAND
    assert ended(bench, 0xA2, 1, 9) == why.NO_COMMAND
    begin_down(bench, HEARTBEAT, 2)
    assert code_of(told(bench, 1, 0xF4, 1)[0]) == why.WRONG_LENGTH, "more than there is"
    assert code_of(begin_down(bench, HEARTBEAT, 3)) == why.WRONG_LENGTH
    assert code_of(begin_down(bench, NUMBER, 4)) == why.READ_ONLY
    assert code_of(begin_down(bench, (0x1018, 9), 4)) == why.NO_SUBINDEX
    assert code_of(begin_up(bench, (0x2000, 0))) == why.NO_OBJECT
    for size in (0, 128, 255):
        assert code_of(begin_up(bench, TEXT, size)) == why.BLOCK_SIZE == 0x05040002
    begin_up(bench, TEXT, 3)
    told(bench, 0xA3)
    assert code_of(told(bench, 0xA2, 4, 3)[0]) == why.SEQUENCE == 0x05040003
    begin_up(bench, TEXT, 3)
    told(bench, 0xA3)
    assert code_of(told(bench, 0xA2, 3, 128)[0]) == why.BLOCK_SIZE
    for early in (0xA1, 0xA2, 0xC1, 0x60, 0x00):
        begin_up(bench, TEXT)
        assert code_of(told(bench, early)[0]) == why.NO_COMMAND, hex(early)
        assert code_of(told(bench, 0xA3)[0]) == why.NO_COMMAND, "the transfer is over"
    assert bench[Row.HEARTBEAT_MS] == 0
    begin_down(bench, (0x6060, 0), 1, crc=False)
    told(bench, 0x81, 5)
    assert code_of(told(bench, 0xC1 | 6 << 2)[0]) == why.WRONG_VALUE
    assert bench.d.mistakes[Mistake.SDO_ABORTED] == 26


def test_a_master_that_dies_in_a_block_is_given_up_and_the_next_one_served(bench: Bench) -> None:
    for begin in (lambda: begin_up(bench, TEXT), lambda: begin_down(bench, HEARTBEAT, 2)):
        begin()
        before = len(bench.said)
        bench.cycles(1100)
        aborts = [one.data for one in bench.said[before:] if one.id == 0x580 + NODE]
        assert [code_of(one) for one in aborts] == [why.TIMED_OUT]
        assert bench.read(0x1018, 3) == 1 << 16
    begin_down(bench, HEARTBEAT, 2)
    assert told(bench, 0x80) == [], "given up by the master"
    assert bench.read(0x1017) == 0


STAGES = {  # the frames of a transfer up to each place where its master may die
    "begin up": ((0xA4, 8, 0x10, 0, 3),),
    "acknowledgement": ((0xA4, 8, 0x10, 0, 3), (0xA3,)),
    "second block": ((0xA4, 8, 0x10, 0, 3), (0xA3,), (0xA2, 3, 3)),
    "again": ((0xA4, 8, 0x10, 0, 3), (0xA3,), (0xA2, 0, 3)),
    "end up": ((0xA4, 0x18, 0x10, 3, 3), (0xA3,), (0xA2, 1, 3)),
    "begin down": ((0xC6, 0x17, 0x10, 0, 2),),
    "segment again": ((0xC6, 0x17, 0x10, 0, 2), (2,)),
    "end down": ((0xC6, 0x17, 0x10, 0, 2), (0x81, 7)),
    "segments up": ((0x40, 8, 0x10, 0), (0x60,)),
    "segments down": ((0x20, 0x17, 0x10, 0), (0x0C, 7)),
}


@pytest.mark.parametrize("stage", STAGES)
def test_a_master_has_a_second_from_each_of_its_frames_on(bench: Bench, stage: str) -> None:
    for frame in STAGES[stage]:
        assert told(bench, *frame)[0][0] != 0x80, frame
        before = len(bench.said)
        bench.cycles(990)
        assert bench.d.state.segment_row != 0 and len(bench.said) == before, frame
    last_said = len(bench.said)
    bench.cycles(11)
    assert len(bench.said) == last_said and bench.d.state.segment_row != 0
    (abort,) = bench.cycles(1).said[last_said:]
    assert code_of(abort.data) == why.TIMED_OUT == 0x05040000
    about = STAGES[stage][0][1:4]
    assert tuple(abort.data[1:4]) == about and bench.d.state.segment_row == 0
    assert bench.cycles(2000).said[last_said + 1 :] == [], "once"


def test_foreign_frames_and_a_reset_in_a_block_change_nothing_else(bench: Bench) -> None:
    begin_down(bench, HEARTBEAT, 2, crc=False)
    assert bench.send(0x600 + NODE + 1, bytes([0x81, *bytes(7)])) == []
    assert bench.send(0x600 + NODE, b"\x81\7") == [], "shorter than eight bytes"
    told(bench, 0x81, 7, 0)
    assert told(bench, 0xC1 | 5 << 2)[0][0] == 0xA1 and bench[Row.HEARTBEAT_MS] == 7
    begin_down(bench, HEARTBEAT, 2)
    bench.send(0, bytes([130, NODE]))
    bench.cycles(2)
    assert bench.d.state.nmt == Heartbeat.PRE_OPERATIONAL
    assert told(bench, 0x81, 7, 0) == [], "out of a block it is an abort"
    assert code_of(told(bench, 0xC1 | 5 << 2)[0]) == why.NO_COMMAND
