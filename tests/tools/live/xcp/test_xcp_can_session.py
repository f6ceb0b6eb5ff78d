"""XCP on CAN in process: parts of a value, blocks, budget, ids that clash, hostile frames."""

import math
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fd_rig import fd_rig
from processes import RIGS
from test_xcp_slave import A2L, NAMES, VALUES, Node, bad, good, listed, refused

from pcpc.drivers.can.plain_bus import BusFrame
from pcpc.drivers.can.wire_layout import LENGTHS, Flag
from pcpc.executive.errors import RigError
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.bus_keys import Xcp
from pcpc.executive.rig.bus_load import bus_load, check_rate
from pcpc.executive.rig.messages import database_of
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.xcp import xcp_ids
from pcpc.tools.live.xcp import on_can
from pcpc.tools.live.xcp.on_can import CanMaster, CanPlace
from pcpc.tools.live.xcp.packets import LAYOUTS, Cmd, Err, Link
from pcpc.tools.live.xcp.slave import XcpSession
from pcpc.tools.start.bus import traffic

CLASSIC, FD = Link(8, 8, 4.0, 50), Link(64, 64, 4.0, 50)
PROBE = RIGS.parents[1] / "probe" / "rig.yaml"


@pytest.fixture
def node() -> Node:
    return Node()


@pytest.fixture
def session(node: Node) -> XcpSession:
    return connected(node, CLASSIC)


def connected(node: Node, link: Link) -> XcpSession:
    made = XcpSession(node.table(), link)
    (answer,) = made.answers(b"\xff\x00".ljust(8, b"\xaa"))
    assert answer == bytes([0xFF, 0x05, 0xC0, link.cto]) + struct.pack("<HBB", link.dto, 1, 1)
    return made


def uploaded(session: XcpSession, count: int) -> bytes:
    answers = session.answers(bytes([Cmd.UPLOAD, count]))
    assert all(one[0] == 0xFF and len(one) <= 8 for one in answers), answers
    return b"".join(one[1:] for one in answers)


def block(data: bytes) -> list[bytes]:
    """Return the packets of a download on classic CAN, padded."""
    packets = [
        bytes([Cmd.DOWNLOAD_NEXT if at else Cmd.DOWNLOAD, len(data) - at]) + data[at : at + 6]
        for at in range(0, len(data), 6)
    ]
    return [one.ljust(8, b"\x55") for one in packets]


def test_a_double_is_uploaded_in_a_block_or_in_parts_of_one_reading(
    session: XcpSession, node: Node
) -> None:
    old = node.values.copy()
    good(session, Cmd.SET_MTA, 0, 0)
    assert uploaded(session, 40) == VALUES.tobytes()
    for first, second in ((4, 4), (7, 1), (1, 7)):
        node.values[:] = old
        assert good(session, Cmd.SHORT_UPLOAD, first, 0, 8) == old.tobytes()[8 : 8 + first]
        node.values[:] = 7.0
        rest = good(session, Cmd.SHORT_UPLOAD, second, 0, 8 + first)
        assert rest == old.tobytes()[8 + first : 16], "of the first part's reading"
        assert good(session, Cmd.SHORT_UPLOAD, 4, 0, 12) == struct.pack("<d", 7.0)[4:], "anew"
    assert bad(session, Cmd.SHORT_UPLOAD, 8, 0, 0) == Err.OUT_OF_RANGE
    length = struct.unpack("<BxxI", good(session, Cmd.GET_ID, 4))[1]
    whole, rest = divmod(length, 255)
    got = b"".join(uploaded(session, 255) for _ in range(whole)) + uploaded(session, rest)
    assert got == A2L
    assert good(session, Cmd.GET_COMM_MODE_INFO) == bytes([0, 1, 0, 43, 50, 0, 0x10])
    assert good(session, Cmd.GET_DAQ_RESOLUTION_INFO)[:2] == b"\x01\x07"


def test_a_double_is_set_by_a_block_or_not_at_all(session: XcpSession, node: Node) -> None:
    value = struct.pack("<d", 120.0)
    good(session, Cmd.SET_MTA, 0, 16)
    first, last = block(value)
    assert session.answers(first) == [] and node.written == []
    cycle = struct.pack("<Q", 4321)[:6]
    assert session.answers(last) == [b"\xff", b"\xfd\xfe" + cycle]
    good(session, Cmd.SET_MTA, 0, 16)
    both = block(struct.pack("<dd", 121.0, 62.0))
    assert [len(session.answers(one)) for one in both] == [0, 0, 2]
    assert node.written[1:] == [{"controller.kv": 121.0, "controller.km": 62.0}]
    good(session, Cmd.SET_MTA, 0, 16)
    out_of_sequence = bytes([0xFE, Err.SEQUENCE])  # and how many bytes were expected
    assert session.answers(last) == [out_of_sequence + b"\x00"], "without its beginning"
    session.answers(both[0])
    assert session.answers(both[2]) == [out_of_sequence + b"\x0a"], "a packet was lost"
    assert session.answers(both[1]) == [out_of_sequence + b"\x00"], "the block is over"
    session.answers(first)
    good(session, Cmd.GET_STATUS)
    assert session.answers(last) == [out_of_sequence + b"\x00"], "another command has ended it"
    session.answers(first)
    assert refused(session, last[:3]) == Err.CMD_SYNTAX, "too short"
    assert refused(session, block(value[:6])[0]) == Err.OUT_OF_RANGE, "a part of a parameter"
    assert refused(session, bytes([Cmd.SHORT_DOWNLOAD, 8, 0, 0, 16, 0, 0, 0])) == Err.CMD_SYNTAX
    session.answers(block(struct.pack("<d", 1001.0))[0])
    assert refused(session, block(struct.pack("<d", 1001.0))[1]) == Err.OUT_OF_RANGE
    assert len(node.written) == 2


def test_a_list_has_parts_of_doubles_a_stamp_alone_and_a_budget(session: XcpSession) -> None:
    listed(session, [], [(8, 4)], [(12, 4), (0, 3)], [(3, 5)])
    good(session, Cmd.SET_DAQ_LIST_MODE, 0x10, 0, 0, 1, 0)
    good(session, Cmd.START_STOP_DAQ_LIST, 1, 0)
    packets = session.packets(np.array([3]), np.array([[0.3, -2.5, 1.0]]))
    assert packets[0] == b"\x00" + struct.pack("<I", 3000) and max(map(len, packets)) == 8
    parts = [one[1:] for one in packets[1:]]
    assert struct.unpack("<d", parts[0] + parts[1][:4]) == (-2.5,)
    assert struct.unpack("<d", parts[1][4:] + parts[2]) == (0.3,)
    listed(session, [(0, 7)])
    assert bad(session, Cmd.WRITE_DAQ, 0xFF, 8, 0, 0) == Err.OUT_OF_RANGE
    listed(session, *[[(0, 4)]] * 5)
    assert bad(session, Cmd.START_STOP_DAQ_LIST, 1, 0) == Err.DAQ_CONFIG, "five of four in a cycle"
    good(session, Cmd.SET_DAQ_LIST_MODE, 0, 0, 0, 2, 0)
    good(session, Cmd.START_STOP_DAQ_LIST, 1, 0)


def test_what_runs_counts_in_the_budget_of_what_starts(session: XcpSession) -> None:
    good(session, Cmd.FREE_DAQ)
    good(session, Cmd.ALLOC_DAQ, 2)
    for number, count in ((0, 3), (1, 2)):
        good(session, Cmd.ALLOC_ODT, number, count)
    tables = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1)]
    for number, odt in tables:
        good(session, Cmd.ALLOC_ODT_ENTRY, number, odt, 1)
    for number, odt in tables:
        good(session, Cmd.SET_DAQ_PTR, number, odt, 0)
        good(session, Cmd.WRITE_DAQ, 0xFF, 4, 0, 0)
    good(session, Cmd.START_STOP_DAQ_LIST, 1, 0)
    assert bad(session, Cmd.START_STOP_DAQ_LIST, 1, 1) == Err.DAQ_CONFIG, "3 and 2 of 4 in a cycle"
    good(session, Cmd.START_STOP_DAQ_LIST, 0, 0)
    good(session, Cmd.START_STOP_DAQ_LIST, 1, 1)


class Wire:
    """A bus in memory that takes what `room` says; all that was sent, and when."""

    def __init__(self) -> None:
        self.inbox, self.sent, self.room = (
            list[BusFrame](),
            list[tuple[float, BusFrame]](),
            math.inf,
        )

    def frames(self) -> Iterator[BusFrame]:
        while self.inbox:
            yield self.inbox.pop(0)

    def offer(self, word: int, data: bytes, flags: int = 0) -> bool:
        if len(self.sent) >= self.room:
            return False
        self.sent.append((on_can.time.monotonic(), BusFrame(word, data, flags)))
        return True


def master_of(node: Node, flags: int = Flag.NONE) -> tuple[CanMaster, Wire]:
    place = CanPlace((0x7C0, 0x7C1), flags, Xcp(frames=16), 0.01, (None, None))
    wire = Wire()
    master = CanMaster(place, wire, XcpSession(node.table(), place.link))  # type: ignore[arg-type]
    wire.inbox.append(BusFrame(0x7C0, b"\xff\x00"))
    master.flush()
    assert wire.sent[-1][1].word == 0x7C1 and wire.sent[-1][1].data[:1] == b"\xff"
    return master, wire


def test_a_flood_is_answered_within_the_budget(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0
    monkeypatch.setattr(on_can, "time", SimpleNamespace(monotonic=lambda: now_s))
    master, wire = master_of(node)
    for _ in range(500):
        now_s += 0.001
        wire.inbox += [BusFrame(0x7C0, bytes([Cmd.UPLOAD, 255])), BusFrame(0x7C0, b"\xfd")] * 3
        wire.inbox += [BusFrame(0x7C1, b"\xff\x00"), BusFrame(0x123, b"")] * 3
        master.send([b"\x00" * 8] * 9)
        master.flush()
    at = np.array([one for one, _ in wire.sent])
    assert len(at) > 16 * 45, f"{len(at)} frames in 50 times ten cycles"
    assert (at[16:] - at[:-16]).min() > 0.01 - 1e-9, "never more than 16 in ten cycles"


def test_what_a_full_queue_does_not_take_waits_and_is_told_if_it_is_too_much(node: Node) -> None:
    master, wire = master_of(node)
    wire.room = len(wire.sent)
    for command in (Cmd.FREE_DAQ, Cmd.ALLOC_DAQ, Cmd.ALLOC_ODT, Cmd.ALLOC_ODT_ENTRY):
        given = {Cmd.ALLOC_DAQ: (1,), Cmd.ALLOC_ODT: (0, 1), Cmd.ALLOC_ODT_ENTRY: (0, 0, 1)}
        good(master.session, command, *given.get(command, ()))
    good(master.session, Cmd.SET_DAQ_PTR, 0, 0, 0)
    good(master.session, Cmd.WRITE_DAQ, 0xFF, 4, 0, 0)
    good(master.session, Cmd.START_STOP_DAQ_LIST, 1, 0)
    for i in range(50):
        master.send([struct.pack("<I", i)] * 100)
    master.flush()
    assert not master.lost or wire.sent == wire.sent[: int(wire.room)]
    assert master.lost, "5,000 wait"
    wire.room = math.inf
    while master.wait_s < 0.01 and len(wire.sent) < 200:
        master.flush()
    kept = [struct.unpack("<I", frame.data)[0] for _, frame in wire.sent[1:]]
    assert kept == [i // 100 for i in range(len(kept))], "the oldest first, none in between"
    good(master.session, Cmd.START_STOP_SYNCH, 0)
    wire.inbox.append(BusFrame(0x7C0, b"\xfd"))
    master.flush()
    master.send([b"\x07"])
    while len(wire.sent) < 3 or wire.sent[-1][1].data != b"\x07":
        master.flush()
    assert [frame.data[:2] for _, frame in wire.sent[-3:-1]] == [b"\xff\x00", b"\xfd\x02"]


@pytest.mark.parametrize("link", [CLASSIC, FD])
def test_mutated_frames_are_answered_and_set_whole_parameters_only(node: Node, link: Link) -> None:
    random = np.random.default_rng(link.cto)
    made = connected(node, link)
    right = [bytes([code]) + bytes(layout.size) for code, layout in LAYOUTS.items()]
    right += [
        bytes([Cmd.DOWNLOAD, 8]) + struct.pack("<d", 4.0),
        *block(struct.pack("<d", 5.0)),
        *block(struct.pack("<dd", 5.0, 6.0)),
    ]
    right += [bytes([Cmd.SET_MTA, 0, 0, 0, 16, 0, 0, 0]), bytes([0xC7, 1]) + bytes(8)]
    values = [0, 1, 2, 6, 8, 16, 255]
    for _ in range(50_000):
        packet = bytearray(right[random.integers(len(right))])
        for _ in range(random.integers(0, 3)):
            packet[random.integers(len(packet))] = random.choice([*values, random.integers(256)])
        if random.random() < 0.1:
            packet = bytearray(random.bytes(random.integers(0, link.cto + 1)))
        answers = made.answers(bytes(packet))
        assert len(answers) <= 37 and all(0 < len(one) <= link.cto for one in answers), packet
        if answers and answers[0][0] == 0xFE:
            Err(answers[0][1])
        if made.daq.running:
            packets = made.packets(np.arange(2), np.zeros((2, 3)))
            assert all(len(one) <= link.dto for one in packets)
    assert node.written and all(0 <= v <= 1000 for one in node.written for v in one.values())
    np.testing.assert_array_equal(node.values[[0, 1, 4]], VALUES[[0, 1, 4]])


def test_frames_of_can_fd_have_a_length_that_there_is(node: Node) -> None:
    master, wire = master_of(node, Flag.FD | Flag.BRS)
    master.send([bytes(size) for size in range(1, 65)])
    until_s = time.monotonic() + 30.0
    while len(wire.sent) < 65 and time.monotonic() < until_s:
        master.flush()
    sizes = [len(frame.data) for _, frame in wire.sent[1:]]
    assert sizes == [min(n for n in LENGTHS if n >= size) for size in range(1, 65)]


def rig_with(xcp: str, base: Path = PROBE) -> Rig:
    return load_rig(base, text=f"{base.read_text()}xcp: {xcp}\n", resolve=False)


@pytest.mark.parametrize(
    ("xcp", "clash"),
    [("{can: [0x0A0, 0x7F0]}", "0xA0 is CMD"), ("{can: [0x6FF, 0x700]}", "0x701 is HB_EXEC"),
     ("{can: [0x7F0, 0x7F2]}", "of two nodes"), ("{can: [0x7F0, 0x7F0]}", "of two nodes")],
)  # fmt: skip
def test_an_id_of_another_frame_is_refused_with_free_ones(xcp: str, clash: str) -> None:
    with pytest.raises(RigError, match=clash) as found:
        check_rate(rig_with(xcp), "real")
    cure = str(found.value).rpartition("free is xcp: ")[2]
    assert xcp_ids(rig_with(cure)) == {"executive": (0x7C0, 0x7C1), "plant": (0x7C2, 0x7C3)}


def test_the_key_changes_no_bit_of_a_run_and_no_other_rigs_text() -> None:
    plain, served = (
        load_rig(PROBE, None, ["duration_s=0.05", *more]) for more in ((), ("xcp=can",))
    )
    assert "xcp" not in plain.effective() and served.effective()["xcp"] == "can"
    logs = [in_memory(rig) for rig in (plain, served)]
    for role in ("executive", "plant"):
        one, other = (log.node[role].columns for log in logs)
        assert all(np.array_equal(one[name], other[name], equal_nan=True) for name in one), role


def test_the_bus_counts_the_frames_of_both_nodes(tmp_path: Path) -> None:
    plain, served = rig_with("null"), rig_with("{frames: 12}")
    row, more = (traffic.buses(rig)[0] for rig in (plain, served))
    assert sum(sent.count for sent in more) - len(row) == 2 * (12 + 3)
    loads = [bus_load(rig, database_of(rig), 1000.0, 1e6) for rig in (plain, served)]
    assert loads[1] - loads[0] == pytest.approx(2 * 15 * 135e-6 * 100.0)
    setup = traffic.Setup(1000.0, 1_000_000)
    assert traffic.load(traffic.response_rows(more, setup)) == pytest.approx(loads[1])
    long = load_rig(fd_rig(tmp_path, "bus: {data_bitrate: 5000000}", "xcp: can"), resolve=False)
    added = [one for one in traffic.buses(long)[0] if one.cycles]
    assert {(one.frame.dlc, one.frame.flags) for one in added} == {(64, Flag.FD | Flag.BRS)}
    assert NAMES and sum(one.count for one in added) == 2 * (8 + 2)
