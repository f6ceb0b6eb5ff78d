"""The slave's protocol, packet by packet: what is right, refused, hostile."""

import struct
import zlib
from collections.abc import Mapping

import numpy as np
import pytest

from pcpc.tools.live.xcp.lists import MOST_ENTRIES, MOST_ODTS
from pcpc.tools.live.xcp.packets import ETHERNET, LAYOUTS, Cmd, CommandRefused, Err, Link
from pcpc.tools.live.xcp.slave import NodeTable, XcpSession, period

NAMES = ["time.t_s", "controller.e", "controller.kv", "controller.km", "odd"]
COLUMNS = [0, 1, -1, -1, 2]
VALUES = np.array([0.5, -1.25, 110.0, 60.0, np.nan])
A2L = bytes(range(32, 127)) * 9


class Node:
    """A table of five; `kv` and `km` are set, from 0 to 1000."""

    def __init__(self) -> None:
        self.values, self.written = VALUES.copy(), list[Mapping[str, float]]()

    def read(self) -> tuple[int, np.ndarray]:
        return 1234, self.values

    def write(self, changes: Mapping[str, float]) -> int:
        if any(not name.startswith("controller.k") for name in changes):
            raise CommandRefused(Err.WRITE_PROTECTED)
        if not all(0 <= value <= 1000 for value in changes.values()):
            raise CommandRefused(Err.OUT_OF_RANGE)
        self.written.append(dict(changes))
        for name, value in changes.items():
            self.values[NAMES.index(name)] = value
        return 4321

    def table(self) -> NodeTable:
        return NodeTable("r.executive", "r", 1_000_000, NAMES, COLUMNS, A2L, self.read, self.write)


@pytest.fixture
def node() -> Node:
    return Node()


@pytest.fixture
def session(node: Node) -> XcpSession:
    made = XcpSession(node.table())
    (answer,) = made.answers(b"\xff\x00")
    assert answer == bytes([0xFF, 0x05, 0x80, ETHERNET.cto]) + struct.pack("<H", 1400) + b"\x01\x01"
    return made


def good(session: XcpSession, command: Cmd, *given: int) -> bytes:
    answer, *_ = session.answers(bytes([command]) + LAYOUTS[command].pack(*given))
    assert answer[0] == 0xFF, f"{command.name}{given}: {answer.hex()}"
    return answer[1:]


def refused(session: XcpSession, packet: bytes) -> Err:
    (answer,) = session.answers(packet)
    assert answer[0] == 0xFE and len(answer) == 2, answer.hex()
    return Err(answer[1])


def bad(session: XcpSession, command: Cmd, *given: int) -> Err:
    return refused(session, bytes([command]) + LAYOUTS[command].pack(*given))


def listed(session: XcpSession, *odts: list[tuple[int, int]]) -> None:
    """Make one list of tables of (address, size)."""
    good(session, Cmd.FREE_DAQ)
    good(session, Cmd.ALLOC_DAQ, 1)
    good(session, Cmd.ALLOC_ODT, 0, len(odts))
    for i, entries in enumerate(odts):
        good(session, Cmd.ALLOC_ODT_ENTRY, 0, i, len(entries))
    for i, entries in enumerate(odts):
        for at, (address, size) in enumerate(entries):
            good(session, Cmd.SET_DAQ_PTR, 0, i, at)
            good(session, Cmd.WRITE_DAQ, 0xFF, size, 0, address)


def test_nothing_is_answered_before_a_connection_and_after_it(node: Node) -> None:
    made = XcpSession(node.table())
    for code in range(255):
        assert made.answers(bytes([code, 0, 0, 0])) == []
    made.answers(b"\xff\x00")
    assert made.answers(b"\xfe") == [b"\xff"] and made.answers(b"\xfd") == []


def test_a_command_of_another_length_is_refused(session: XcpSession) -> None:
    for command, layout in LAYOUTS.items():
        for size in {0, 1, layout.size - 1, layout.size + 1, 200} - {layout.size, -1}:
            assert refused(session, bytes([command]) + bytes(size)) == Err.CMD_SYNTAX, command
    for code in set(range(256)) - {*Cmd}:
        assert refused(session, bytes([code])) == Err.CMD_UNKNOWN
    assert bad(session, Cmd.SYNCH) == Err.CMD_SYNCH


def test_values_and_the_file_are_uploaded_and_nothing_else(session: XcpSession) -> None:
    good(session, Cmd.SET_MTA, 0, 8)
    assert struct.unpack("<dd", good(session, Cmd.UPLOAD, 16)) == (-1.25, 110.0)
    assert good(session, Cmd.UPLOAD, 8) == struct.pack("<d", 60.0), "the address goes on"
    assert good(session, Cmd.SHORT_UPLOAD, 4, 0, 4) == struct.pack("<d", 0.5)[4:]
    length = struct.unpack("<BxxI", good(session, Cmd.GET_ID, 4))[1]
    got = b"".join(good(session, Cmd.UPLOAD, n) for n in (254, 254, 254, length - 3 * 254))
    assert got == A2L and bad(session, Cmd.UPLOAD, 1) == Err.OUT_OF_RANGE
    for extension, address, count in (
        (0, 40, 1),
        (0, 33, 8),
        (0, 0xFFFFFFFF, 1),
        (0, 0x80000000, 8),
        (1, len(A2L), 1),
        (2, 0, 255),
        (3, 0, 1),
        (255, 0, 1),
        (0, 0, 0),
        (0, 0, 255),
    ):
        assert bad(session, Cmd.SHORT_UPLOAD, count, extension, address) == Err.OUT_OF_RANGE
    good(session, Cmd.SET_MTA, 0, 0)
    for part in (VALUES.tobytes()[:16], VALUES.tobytes()[16:]):  # it goes on behind the first
        kind, crc = struct.unpack("<BxxI", good(session, Cmd.BUILD_CHECKSUM, len(part)))
        assert (kind, crc) == (9, zlib.crc32(part))
    assert bad(session, Cmd.BUILD_CHECKSUM, 0xFFFFFFFF) == Err.OUT_OF_RANGE


def test_a_value_is_that_of_its_first_part_and_the_next_one_is_new(
    session: XcpSession, node: Node
) -> None:
    good(session, Cmd.SET_MTA, 0, 0)
    read = good(session, Cmd.UPLOAD, 4)
    node.values[:2] = 7.0
    read += good(session, Cmd.UPLOAD, 4) + good(session, Cmd.UPLOAD, 8)
    assert struct.unpack("<dd", read) == (0.5, 7.0)


def test_parameters_are_set_whole_together_and_in_range(session: XcpSession, node: Node) -> None:
    two = struct.pack("<dd", 120.0, 61.0)
    good(session, Cmd.SET_MTA, 0, 16)
    assert session.answers(bytes([0xF0, 16]) + two) == [
        b"\xff",
        b"\xfd\xfe" + struct.pack("<Q", 4321),
    ]
    assert node.written == [{"controller.kv": 120.0, "controller.km": 61.0}]
    assert np.isnan(struct.unpack("<d", good(session, Cmd.UPLOAD, 8))), "the address goes on"

    def short(address: int, data: bytes, extension: int = 0) -> Err:
        head = struct.pack("<BBxBI", 0xED, len(data), extension, address)
        return refused(session, head + data)

    assert short(16, struct.pack("<dd", 1.0, 1001.0)) == Err.OUT_OF_RANGE
    assert short(16, struct.pack("<d", np.nan)) == Err.OUT_OF_RANGE
    assert short(8, struct.pack("<dd", 1.0, 1.0)) == Err.WRITE_PROTECTED
    assert short(0, b"x" * 8, 1) == Err.WRITE_PROTECTED
    assert [short(at, b"x" * 8) for at in (17, 40, 0xFFFFFFFC)] == 3 * [Err.OUT_OF_RANGE]
    assert [short(16, b"x" * n) for n in (0, 1, 7, 9, 32)] == 5 * [Err.OUT_OF_RANGE]
    assert refused(session, b"\xf0") == Err.CMD_SYNTAX
    assert refused(session, bytes([0xF0, 9]) + two) == Err.CMD_SYNTAX
    assert refused(session, bytes([0xED, 8])) == Err.CMD_SYNTAX
    assert len(node.written) == 1 and node.values[2:4].tolist() == [120.0, 61.0]


def test_a_list_sends_what_it_was_told_of_every_cycle(session: XcpSession) -> None:
    listed(session, [(8, 8), (32, 8)], [(0, 4), (12, 2)])
    good(session, Cmd.SET_DAQ_LIST_MODE, 0x10, 0, 0, 2, 0)
    assert good(session, Cmd.START_STOP_DAQ_LIST, 1, 0) == b"\x00"
    assert good(session, Cmd.GET_STATUS)[0] == 0x40
    rows = np.array([[0.1, -2.0, 7.0], [0.2, -3.0, np.inf], [0.3, -4.0, -0.0]])
    sent = session.packets(np.array([8, 9, 10]), rows)
    assert sent == [
        b"\x00" + struct.pack("<Idd", 8000, -2.0, 7.0),
        b"\x01" + struct.pack("<d", 0.1)[:4] + struct.pack("<d", -2.0)[4:6],
        b"\x00" + struct.pack("<Idd", 10000, -4.0, -0.0),
        b"\x01" + struct.pack("<d", 0.3)[:4] + struct.pack("<d", -4.0)[4:6],
    ]
    for command, given in (
        (Cmd.WRITE_DAQ, (0xFF, 8, 0, 0)),
        (Cmd.SET_DAQ_LIST_MODE, (0, 0, 0, 1, 0)),
        (Cmd.ALLOC_ODT, (0, 1)),
        (Cmd.ALLOC_DAQ, (1,)),
    ):
        good(session, Cmd.SET_DAQ_PTR, 0, 0, 0)
        assert bad(session, command, *given) == Err.DAQ_ACTIVE
    good(session, Cmd.START_STOP_SYNCH, 0)
    assert session.packets(np.array([12]), rows[:1]) == []


def test_a_stamp_comes_round(session: XcpSession) -> None:
    listed(session, [(0, 8)])
    good(session, Cmd.SET_DAQ_LIST_MODE, 0x10, 0, 0, 1, 0)
    good(session, Cmd.START_STOP_DAQ_LIST, 1, 0)
    (sent,) = session.packets(np.array([5_000_000]), np.zeros((1, 3)))
    assert struct.unpack("<xI8x", sent)[0] == 5_000_000_000 - 2**32


def test_lists_that_run_count_against_what_a_link_carries(node: Node) -> None:
    made = XcpSession(node.table(), Link(8, 9, frames=1.0))
    made.answers(b"\xff\x00")
    for command, *given in (
        (Cmd.FREE_DAQ,), (Cmd.ALLOC_DAQ, 2), (Cmd.ALLOC_ODT, 0, 1), (Cmd.ALLOC_ODT, 1, 1),
        (Cmd.ALLOC_ODT_ENTRY, 0, 0, 1), (Cmd.ALLOC_ODT_ENTRY, 1, 0, 1),
        (Cmd.SET_DAQ_PTR, 0, 0, 0), (Cmd.WRITE_DAQ, 0xFF, 8, 0, 0),
        (Cmd.SET_DAQ_PTR, 1, 0, 0), (Cmd.WRITE_DAQ, 0xFF, 8, 0, 0),
        (Cmd.START_STOP_DAQ_LIST, 1, 0),
    ):  # fmt: skip
        good(made, command, *given)
    assert bad(made, Cmd.START_STOP_DAQ_LIST, 1, 1) == Err.DAQ_CONFIG


def test_a_block_is_not_gone_on_with_behind_another_command(node: Node) -> None:
    made = XcpSession(node.table(), Link(8, 8))
    made.answers(b"\xff\x00")
    good(made, Cmd.SET_MTA, 0, 16)
    data = struct.pack("<d", 120.0)
    assert made.answers(bytes([Cmd.DOWNLOAD, 8]) + data[:6]) == []
    good(made, Cmd.GET_STATUS)
    (answer,) = made.answers(bytes([Cmd.DOWNLOAD_NEXT, 2]) + data[6:])
    assert answer[:2] == bytes([0xFE, Err.SEQUENCE]) and not node.written


@pytest.mark.parametrize("packet", [b"\xff\x00", b"\xfe"])
def test_a_connection_begins_and_ends_without_a_list(session: XcpSession, packet: bytes) -> None:
    listed(session, [(8, 8)])
    good(session, Cmd.START_STOP_DAQ_LIST, 1, 0)
    assert len(session.packets(np.array([0]), np.zeros((1, 3)))) == 1
    session.answers(packet)
    assert session.packets(np.array([0]), np.zeros((1, 3))) == []


def test_event_channels_are_divisions_of_the_loop(session: XcpSession) -> None:
    listed(session, [(0, 8)])
    rows = np.zeros((300, 3))
    for event, division in ((0, 1), (1, 10), (2, 100)):
        good(session, Cmd.SET_DAQ_LIST_MODE, 0, 0, event, 3, 0)
        good(session, Cmd.START_STOP_DAQ_LIST, 1, 0)
        assert len(session.packets(np.arange(300), rows)) == 300 // (3 * division)
        good(session, Cmd.START_STOP_DAQ_LIST, 0, 0)
        about = good(session, Cmd.GET_DAQ_EVENT_INFO, event)
        assert (
            good(session, Cmd.UPLOAD, about[2]).decode()
            == ("cycle", "cycle_10", "cycle_100")[event]
        )
        assert about[3] * 10 ** about[4] == division * 1_000_000
    assert bad(session, Cmd.GET_DAQ_EVENT_INFO, 3) == Err.OUT_OF_RANGE


@pytest.mark.parametrize("ns", [1, 250, 255, 256, 333_333, 1_000_000, 2_500_000, 10**9, 2 * 10**11])
def test_a_period_has_three_digits(ns: int) -> None:
    count, unit = period(ns)
    assert 0 < count <= 255 and 0 <= unit <= 9
    assert count * 10**unit == pytest.approx(ns, rel=0.02 if ns > 255 else 0.0)


def test_lists_are_built_in_their_order_and_have_an_end(session: XcpSession) -> None:
    good(session, Cmd.FREE_DAQ)
    assert bad(session, Cmd.ALLOC_ODT, 0, 1) == Err.SEQUENCE
    assert bad(session, Cmd.ALLOC_DAQ, MOST_ODTS + 1) == Err.MEMORY_OVERFLOW
    good(session, Cmd.ALLOC_DAQ, MOST_ODTS)
    good(session, Cmd.FREE_DAQ)
    good(session, Cmd.ALLOC_DAQ, 2)
    assert bad(session, Cmd.ALLOC_DAQ, 2) == Err.SEQUENCE
    assert bad(session, Cmd.ALLOC_ODT_ENTRY, 0, 0, 1) == Err.SEQUENCE
    assert bad(session, Cmd.ALLOC_ODT, 2, 1) == Err.OUT_OF_RANGE
    good(session, Cmd.ALLOC_ODT, 0, 200)
    assert bad(session, Cmd.ALLOC_ODT, 1, 53) == Err.MEMORY_OVERFLOW
    good(session, Cmd.ALLOC_ODT, 1, 52)
    good(session, Cmd.ALLOC_ODT, 0, 200)
    for odt in range(MOST_ENTRIES // 255):
        good(session, Cmd.ALLOC_ODT_ENTRY, 0, odt, 255)
    assert bad(session, Cmd.ALLOC_ODT_ENTRY, 0, 199, 255) == Err.MEMORY_OVERFLOW
    assert bad(session, Cmd.ALLOC_ODT_ENTRY, 1, 52, 1) == Err.OUT_OF_RANGE
    assert bad(session, Cmd.ALLOC_ODT, 0, 1) == Err.SEQUENCE
    assert bad(session, Cmd.START_STOP_DAQ_LIST, 1, 0) == Err.DAQ_CONFIG, "empty entries"
    assert bad(session, Cmd.SET_DAQ_PTR, 1, 0, 0) == Err.OUT_OF_RANGE


def test_wrong_entries_and_modes_are_refused(session: XcpSession) -> None:
    listed(session, [(0, 8)], [(8, 8)])
    assert bad(session, Cmd.WRITE_DAQ, 0xFF, 8, 0, 0) == Err.OUT_OF_RANGE, "the table is full"
    good(session, Cmd.SET_DAQ_PTR, 0, 1, 0)
    for bit, size, extension, address, why in (
        (3, 8, 0, 0, Err.OUT_OF_RANGE),
        (0xFF, 0, 0, 0, Err.OUT_OF_RANGE),
        (0xFF, 8, 0, 4, Err.OUT_OF_RANGE),
        (0xFF, 8, 1, 0, Err.OUT_OF_RANGE),
        (0xFF, 8, 0, 40, Err.OUT_OF_RANGE),
        (0xFF, 8, 0, 16, Err.DAQ_CONFIG),
    ):
        assert bad(session, Cmd.WRITE_DAQ, bit, size, extension, address) == why
    assert good(session, Cmd.READ_DAQ) == struct.pack("<BBBI", 0xFF, 8, 0, 8)
    assert bad(session, Cmd.SET_DAQ_LIST_MODE, 0x02, 0, 0, 1, 0) == Err.MODE_NOT_VALID
    assert bad(session, Cmd.SET_DAQ_LIST_MODE, 0x20, 0, 0, 1, 0) == Err.MODE_NOT_VALID
    assert bad(session, Cmd.SET_DAQ_LIST_MODE, 0, 0, 3, 1, 0) == Err.OUT_OF_RANGE
    assert bad(session, Cmd.SET_DAQ_LIST_MODE, 0, 0, 0, 0, 0) == Err.OUT_OF_RANGE
    assert bad(session, Cmd.START_STOP_DAQ_LIST, 3, 0) == Err.MODE_NOT_VALID
    assert bad(session, Cmd.START_STOP_SYNCH, 3) == Err.MODE_NOT_VALID
    good(session, Cmd.FREE_DAQ)
    assert bad(session, Cmd.WRITE_DAQ, 0xFF, 8, 0, 0) == Err.SEQUENCE


def test_lists_start_together_or_not_at_all(session: XcpSession) -> None:
    good(session, Cmd.FREE_DAQ)
    good(session, Cmd.ALLOC_DAQ, 2)
    for i in (0, 1):
        good(session, Cmd.ALLOC_ODT, i, 1)
    for i in (0, 1):
        good(session, Cmd.ALLOC_ODT_ENTRY, i, 0, 1)
    good(session, Cmd.SET_DAQ_PTR, 0, 0, 0)
    good(session, Cmd.WRITE_DAQ, 0xFF, 8, 0, 0)
    for i in (0, 1):
        good(session, Cmd.START_STOP_DAQ_LIST, 2, i)
    assert bad(session, Cmd.START_STOP_SYNCH, 1) == Err.DAQ_CONFIG
    assert session.packets(np.array([0]), np.zeros((1, 3))) == []


def test_what_was_selected_is_no_more_once_it_was_started_or_stopped(session: XcpSession) -> None:
    good(session, Cmd.FREE_DAQ)
    good(session, Cmd.ALLOC_DAQ, 2)
    for i in (0, 1):
        good(session, Cmd.ALLOC_ODT, i, 1)
    for i in (0, 1):
        good(session, Cmd.ALLOC_ODT_ENTRY, i, 0, 1)
    for i in (0, 1):
        good(session, Cmd.SET_DAQ_PTR, i, 0, 0)
        good(session, Cmd.WRITE_DAQ, 0xFF, 8, 0, 0)
    stop_all, start, stop, select = 0, 1, 2, 2
    for steps, sent in (
        (((select, 0), (select, 1), stop_all, start), []),  # selected, then all stopped
        (((select, 0), start), [0]),
        (((select, 1), start), [0, 1]),  # the first is not selected any more, but runs on
        ((stop,), [0, 1]),  # nothing is selected
        (((select, 0), stop), [1]),
        ((start,), [1]),
        (((select, 0), stop_all), []),
        ((start,), []),
    ):
        for step in steps:
            if isinstance(step, tuple):
                good(session, Cmd.START_STOP_DAQ_LIST, *step)
            else:
                good(session, Cmd.START_STOP_SYNCH, step)
        assert [one[0] for one in session.packets(np.array([0]), np.zeros((1, 3)))] == sent, steps
    good(session, Cmd.START_STOP_DAQ_LIST, select, 0)
    good(session, Cmd.START_STOP_DAQ_LIST, select, 1)
    good(session, Cmd.CLEAR_DAQ_LIST, 0)
    good(session, Cmd.START_STOP_SYNCH, start)
    assert [one[0] for one in session.packets(np.array([0]), np.zeros((1, 3)))] == [1]


def test_a_packet_that_is_too_long_for_a_frame_is_refused(session: XcpSession) -> None:
    listed(session, [(0, 8)] * 175)
    assert bad(session, Cmd.START_STOP_DAQ_LIST, 1, 0) == Err.DAQ_CONFIG
    listed(session, [(0, 8)] * 174)
    good(session, Cmd.SET_DAQ_LIST_MODE, 0x10, 0, 0, 1, 0)
    good(session, Cmd.START_STOP_DAQ_LIST, 1, 0)
    assert len(session.packets(np.array([0]), np.zeros((1, 3)))[0]) == 1397


def test_whatever_comes_is_answered_by_one_packet_and_moves_nothing(node: Node) -> None:
    """Random packets, and right ones with changed bytes; what is written is in its range."""
    random = np.random.default_rng(38)
    made = XcpSession(node.table())
    right = [bytes([code]) + bytes(layout.size) for code, layout in LAYOUTS.items()]
    right += [bytes([0xF0, 8]) + struct.pack("<d", 5.0), bytes([0xC7, 1]) + bytes(8)]
    for _ in range(20_000):
        packet = bytearray(right[random.integers(len(right))])
        for _ in range(random.integers(0, 4)):
            packet[random.integers(len(packet))] = random.choice(
                [0, 1, 2, 8, 16, 255, random.integers(256)]
            )
        if random.random() < 0.1:
            packet = bytearray(random.bytes(random.integers(1, 40)))
        answers = made.answers(bytes(packet))
        assert len(answers) <= 2 and all(0 < len(one) <= ETHERNET.cto for one in answers)
        assert not answers or answers[0][0] in (0xFE, 0xFF)
        if answers and answers[0][0] == 0xFE:
            Err(answers[0][1])
        if made.daq.running:
            made.packets(np.arange(3), np.zeros((3, 3)))
    assert all(0 <= value <= 1000 for one in node.written for value in one.values())
    np.testing.assert_array_equal(node.values[[0, 1, 4]], VALUES[[0, 1, 4]])
