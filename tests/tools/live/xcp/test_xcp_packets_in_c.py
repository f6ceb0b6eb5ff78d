"""The slave in C alone, compiled with sanitizers: what is right, refused, hostile."""

import random
import shutil
import struct
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from pcpc.executive.rig.reading import load_rig
from pcpc.tools.live.xcp.packets import LAYOUTS, Cmd, Err
from pcpc.tools.make.generate.device import device
from pcpc.tools.start.rigs import find

HOST = Path(__file__).with_name("xcp_host.c")
KNOWN = "XCP_MASTER 0x7E0u", "XCP_SLAVE 0x7E1u"
DOWNLOAD_NEXT, CONNECT = 0xEF, b"\xff\x00"
NAN = float("nan")


@dataclass(frozen=True)
class Turn:
    """What followed a packet: answers, and what a cycle behind it sent."""

    answers: list[bytes]
    cycle: list[bytes]


class Slave:
    """The program; its table has doubles at 0 to 24, 16 and 24 are set within 0 and 1000."""

    def __init__(self, program: Path) -> None:
        self.program = str(program)

    def take(self, packets: Sequence[bytes]) -> tuple[list[Turn], tuple[float, ...]]:
        """Return the turns and the table at the end."""
        given = b"".join(bytes([len(one)]) + one for one in packets)
        done = subprocess.run([self.program], input=given, capture_output=True)
        assert done.returncode == 0 and not done.stderr, done.stderr.decode()[-2000:]
        turns, at = list[Turn](), 0
        into = list[bytes]()
        while (byte := done.stdout[at]) != ord("!"):
            at += 1
            if byte == ord("="):
                into = []
                turns.append(Turn(into, []))
            elif byte == ord("*"):
                into = turns[-1].cycle
            else:
                into.append(done.stdout[at : at + byte])
                at += byte
        return turns, struct.unpack("<5d", done.stdout[at + 1 :])

    def answers(self, *packets: bytes) -> list[bytes]:
        """Return the first answers of a session, b"" for none."""
        turns, _ = self.take([CONNECT, *packets])
        return [b"".join(turn.answers[:1]) for turn in turns[1:]]


@pytest.fixture(scope="module")
def slave(tmp_path_factory: pytest.TempPathFactory) -> Slave:
    """Compile xcp.c with the table of `xcp_host.c`."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler; apt-get install gcc libc6-dev")
    folder = tmp_path_factory.mktemp("xcp")
    files = device(load_rig(find("probe")), "0x7E0,0x7E1")
    for name, text in files.items():
        if name.endswith(".h") or name == "xcp.c":
            (folder / name).write_text(text)
    header = folder / "xcp_rig.h"
    lines = header.read_text().splitlines()
    assert sum("define XCP_VARIABLES" in line for line in lines) == 1
    header.write_text(
        "\n".join(
            "#define XCP_VARIABLES 5u" if "define XCP_VARIABLES" in line else line for line in lines
        )
    )
    warnings = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"]
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1"]
    words = ["cc", "-std=c99", *warnings, *checks, "-I", str(folder), "-o", str(folder / "host")]
    subprocess.run([*words, str(folder / "xcp.c"), str(HOST)], check=True)
    return Slave(folder / "host")


def packet(command: Cmd, *given: int) -> bytes:
    return bytes([command]) + LAYOUTS[command].pack(*given)


def mta(address: int, extension: int = 0) -> bytes:
    return packet(Cmd.SET_MTA, extension, address)


def block(*values: float) -> list[bytes]:
    data = struct.pack(f"<{len(values)}d", *values)
    parts = [data[i : i + 6] for i in range(0, len(data), 6)]
    codes = [Cmd.DOWNLOAD] + [DOWNLOAD_NEXT] * (len(parts) - 1)
    return [
        bytes([code, len(data) - 6 * i]) + part
        for i, (code, part) in enumerate(zip(codes, parts, strict=True))
    ]


def listed(*odts: list[tuple[int, int]]) -> list[bytes]:
    """Return what makes a list of packets of (address, size)."""
    made = [packet(Cmd.FREE_DAQ), packet(Cmd.ALLOC_DAQ, 1), packet(Cmd.ALLOC_ODT, 0, len(odts))]
    made += [packet(Cmd.ALLOC_ODT_ENTRY, 0, i, len(odt)) for i, odt in enumerate(odts)]
    for i, odt in enumerate(odts):
        made += [packet(Cmd.SET_DAQ_PTR, 0, i, 0)] * bool(odt)
        made += [packet(Cmd.WRITE_DAQ, 0xFF, size, 0, address) for address, size in odt]
    return made


def refused(code: Err) -> bytes:
    return bytes([0xFE, code])


def test_nobody_is_answered_before_a_connection_and_after_it(slave: Slave) -> None:
    turns, _ = slave.take([b"", *(bytes([code]) for code in range(255)), b"\xff\x07"])
    assert [one.answers for one in turns] == [[]] * 256 + [[refused(Err.OUT_OF_RANGE)]]
    connected, left, after = slave.take([CONNECT, b"\xfe", b"\xfd"])[0]
    assert connected.answers == [bytes([0xFF, 5, 0xC0, 8, 8, 0, 1, 1])]
    assert left.answers == [b"\xff"] and after.answers == []


def test_short_and_unknown_commands_are_refused_and_padded_ones_taken(slave: Slave) -> None:
    answers = [slave.answers(bytes([code]))[0] for code in range(256)]
    known = {code for code, told in enumerate(answers) if told != refused(Err.CMD_UNKNOWN)}
    ours = {one for one in Cmd if one in known}
    assert {Cmd.GET_SEED, Cmd.BUILD_CHECKSUM, Cmd.SHORT_DOWNLOAD} & known == set()
    assert known == {*ours, DOWNLOAD_NEXT} and len(known) == 24
    short = [
        bytes([one]) + bytes(size)
        for one in ours
        if one in LAYOUTS
        for size in range(LAYOUTS[one].size)
    ]
    assert {*slave.answers(*short)} == {refused(Err.CMD_SYNTAX)}
    assert slave.answers(b"\xfd" + bytes(7), b"\xfc" + bytes(7)) == [
        b"\xff\x00\x00\x00\x00\x00",
        refused(Err.CMD_SYNCH),
    ]


def test_values_and_texts_are_uploaded_and_nothing_else(slave: Slave) -> None:
    turns, _ = slave.take([CONNECT, mta(8), packet(Cmd.UPLOAD, 16), packet(Cmd.GET_ID, 2),
                           packet(Cmd.UPLOAD, 9), packet(Cmd.UPLOAD, 1)])  # fmt: skip
    two = struct.pack("<dd", -1.25, 110.0)
    assert turns[2].answers == [b"\xff" + two[:7], b"\xff" + two[7:14], b"\xff" + two[14:]]
    assert turns[3].answers == [b"\xff\x00\x00\x00" + struct.pack("<I", 9)]
    assert turns[4].answers == [b"\xffprobe.a", b"\xff2l"]
    assert turns[5].answers == [refused(Err.OUT_OF_RANGE)]
    asked = [packet(Cmd.SHORT_UPLOAD, *one) for one in (
        (1, 0, 40), (7, 0, 34), (4, 0, 0xFFFFFFFE), (1, 1, 0), (1, 3, 0), (0, 0, 0), (8, 0, 0),
    )]  # fmt: skip
    assert slave.answers(*asked) == [refused(Err.OUT_OF_RANGE)] * 7
    asked = [packet(Cmd.SHORT_UPLOAD, 1, 0, 32), packet(Cmd.SHORT_UPLOAD, 4, 0, 30)]
    assert slave.answers(*asked) == [refused(Err.ACCESS_DENIED)] * 2


def test_parameters_are_set_whole_together_and_in_range(slave: Slave) -> None:
    turns, table = slave.take([CONNECT, mta(16), *block(120.0, 61.0), *[b"\xfd"] * 2])
    assert [one.answers for one in turns[2:5]] == [[], [], [b"\xff"]]
    assert table == (0.5, -1.25, 120.0, 61.0, 7.0)
    assert [one for turn in turns for one in turn.cycle] == [b"\xfd\xfe" + struct.pack("<IH", 6, 0)]
    for at, values, why in (
        (16, (1.0, 1001.0), Err.OUT_OF_RANGE),
        (16, (NAN,), Err.OUT_OF_RANGE),
        (16, (float("inf"),), Err.OUT_OF_RANGE),
        (8, (1.0, 1.0), Err.WRITE_PROTECTED),
        (24, (1.0, 1.0), Err.ACCESS_DENIED),
        (24, (1.0, 1.0, 1.0), Err.OUT_OF_RANGE),
        (17, (1.0,), Err.OUT_OF_RANGE),
        (0xFFFFFFF8, (1.0,), Err.OUT_OF_RANGE),
    ):
        turns, table = slave.take([CONNECT, mta(at), *block(*values)])
        assert turns[-1].answers == [refused(why)] and not any(one.cycle for one in turns)
        assert table == (0.5, -1.25, 110.0, 60.0, 7.0)
    first, last = block(5.0)
    short = first[:7]
    for packets, why in (
        ([last], Err.SEQUENCE),
        ([first, b"\xfd", last], Err.SEQUENCE),
        ([first, last[:1] + b"\x03" + last[2:]], Err.SEQUENCE),
        ([short], Err.CMD_SYNTAX),
        ([short, last], Err.SEQUENCE),
        ([b"\xf0\x00"], Err.OUT_OF_RANGE),
        ([b"\xf0\x31" + bytes(6)], Err.OUT_OF_RANGE),
        ([b"\xf0\x04" + bytes(4)], Err.OUT_OF_RANGE),
        ([packet(Cmd.GET_ID, 1), first, last], Err.WRITE_PROTECTED),
    ):
        assert slave.answers(mta(16), *packets)[-1] == refused(why), packets


def test_a_list_sends_parts_of_variables_in_its_cycles(slave: Slave) -> None:
    mode = packet(Cmd.SET_DAQ_LIST_MODE, 0x10, 0, 0, 2, 0)
    start = packet(Cmd.START_STOP_DAQ_LIST, 1, 0)
    made = [CONNECT, *listed([(0, 3)], [(3, 5)], [(16, 4), (21, 1)]), mode, start]
    waits = [packet(Cmd.GET_STATUS)] * 13
    turns, _ = slave.take([*made, *waits])
    assert all(turn.answers[0][0] == 0xFF for turn in turns)
    sent = {k: turn.cycle for k, turn in enumerate(turns) if turn.cycle}
    half, gain = struct.pack("<d", 0.5), struct.pack("<d", 110.0)
    first = -(-(len(made) - 1) // 6) * 6  # the program does each third cycle, the list each second
    assert [*sent] == list(range(first, len(turns), 6)) and len(sent) > 1
    for k, packets in sent.items():
        assert packets == [
            b"\x00" + struct.pack("<I", 1000 * k) + half[:3], b"\x01" + half[3:],
            b"\x02" + gain[:4] + gain[5:6],
        ]  # fmt: skip
    assert turns[-1].answers[0][1] == 0x40
    stops = packet(Cmd.START_STOP_SYNCH, 0), packet(Cmd.START_STOP_DAQ_LIST, 0, 0), b"\xd6", b"\xfe"
    for stop in stops:
        turns, _ = slave.take([*made, stop, *waits])
        assert not any(turn.cycle for turn in turns[len(made) :])


def test_a_list_is_built_in_its_order_and_has_an_end(slave: Slave) -> None:
    alloc, odt, entry = Cmd.ALLOC_DAQ, Cmd.ALLOC_ODT, Cmd.ALLOC_ODT_ENTRY
    point, write, start = Cmd.SET_DAQ_PTR, Cmd.WRITE_DAQ, Cmd.START_STOP_DAQ_LIST
    one = listed([(0, 7)])
    running = [*one, packet(start, 1, 0)]
    mode = Cmd.SET_DAQ_LIST_MODE
    for packets, why in (
        ([packet(odt, 0, 1)], Err.SEQUENCE),
        ([packet(alloc, 2)], Err.MEMORY_OVERFLOW),
        ([packet(alloc, 1), packet(alloc, 1)], Err.SEQUENCE),
        ([packet(alloc, 1), packet(entry, 0, 0, 1)], Err.SEQUENCE),
        ([packet(alloc, 1), packet(odt, 1, 1)], Err.OUT_OF_RANGE),
        ([packet(alloc, 1), packet(odt, 0, 33)], Err.MEMORY_OVERFLOW),
        ([*one[:3], packet(entry, 0, 1, 1)], Err.OUT_OF_RANGE),
        ([*one[:3], packet(entry, 0, 0, 8)], Err.MEMORY_OVERFLOW),
        ([*one[:4], packet(start, 1, 0)], Err.DAQ_CONFIG),
        ([packet(start, 1, 0)], Err.OUT_OF_RANGE),
        ([*one, packet(odt, 0, 1)], Err.SEQUENCE),
        ([packet(write, 0xFF, 1, 0, 0)], Err.SEQUENCE),
        ([*one, packet(point, 0, 0, 1)], Err.OUT_OF_RANGE),
        ([*one, packet(write, 0xFF, 1, 0, 0)], Err.OUT_OF_RANGE),
        *(
            ([*one[:5], packet(write, *given)], Err.OUT_OF_RANGE)
            for given in (
                (3, 1, 0, 0),
                (0xFF, 0, 0, 0),
                (0xFF, 8, 0, 0),
                (0xFF, 4, 0, 6),
                (0xFF, 1, 1, 0),
                (0xFF, 1, 0, 40),
                (0xFF, 1, 0, 0xFFFFFFFF),
            )
        ),
        ([*one[:5], packet(write, 0xFF, 1, 0, 32)], Err.ACCESS_DENIED),
        ([*one, packet(mode, 0x10, 0, 0, 1, 0), packet(start, 1, 0)], Err.DAQ_CONFIG),
        ([*one, packet(mode, 0x02, 0, 0, 1, 0)], Err.MODE_NOT_VALID),
        ([*one, packet(mode, 0, 0, 3, 1, 0)], Err.OUT_OF_RANGE),
        ([*one, packet(mode, 0, 0, 0, 0, 0)], Err.OUT_OF_RANGE),
        ([*one, packet(start, 3, 0)], Err.MODE_NOT_VALID),
        ([*listed([(0, 4), (8, 4)]), packet(start, 1, 0)], Err.DAQ_CONFIG),
        ([*running, packet(alloc, 1)], Err.DAQ_ACTIVE),
        ([*running, packet(write, 0xFF, 1, 0, 0)], Err.DAQ_ACTIVE),
        ([*running, packet(mode, 0, 0, 0, 1, 0)], Err.DAQ_ACTIVE),
        ([packet(Cmd.GET_DAQ_EVENT_INFO, 3)], Err.OUT_OF_RANGE),
        ([packet(Cmd.START_STOP_SYNCH, 3)], Err.MODE_NOT_VALID),
    ):
        assert slave.answers(*packets)[-1] == refused(why), (packets, why)


def hostile(count: int) -> Iterator[bytes]:
    """Yield sessions in which bytes are changed, left out and put in, and nonsense."""
    draw = random.Random(38)
    right = [bytes([one]) + bytes(layout.size) for one, layout in LAYOUTS.items()]
    while count > 0:
        odts = [
            [
                (draw.choice((0, 8, 17, 24, 32)), draw.randrange(1, 8))
                for _ in range(draw.randrange(0, 3))
            ]
            for _ in range(draw.randrange(1, 5))
        ]
        session = [
            CONNECT, *listed(*odts), packet(Cmd.SET_DAQ_LIST_MODE, 0x10, 0, 0, 1, 0),
            packet(Cmd.START_STOP_DAQ_LIST, 1, 0), mta(draw.choice((0, 8, 16, 16, 24))),
            *block(*(draw.choice((5.0, NAN, 2000.0, -0.0)) for _ in range(draw.randrange(1, 4)))),
            mta(16), *block(draw.uniform(0.0, 1000.0)), *draw.choices(right, k=4),
        ]  # fmt: skip
        for one in session:
            changed = bytearray(one)
            if draw.random() < 0.2:
                changed[draw.randrange(len(one))] = draw.choice(
                    (0, 1, 2, 8, 255, draw.randrange(256))
                )
            if draw.random() < 0.03:
                changed = bytearray(draw.randbytes(draw.randrange(0, 12)))
            count -= 1
            yield bytes(changed)


def test_hostile_packets_are_answered_and_move_nothing_else(slave: Slave) -> None:
    packets = [*hostile(100_000)]
    turns, table = slave.take(packets)
    connected, written, measured = False, 0, 0
    for one, turn in zip(packets, turns, strict=True):
        code = one[0] if one else -1
        if not one or not (connected or code == Cmd.CONNECT):
            assert not turn.answers
        elif not turn.answers:
            assert code in (Cmd.DOWNLOAD, DOWNLOAD_NEXT), one.hex()
        else:
            first, *more = turn.answers
            assert first[0] in (0xFE, 0xFF) and (not more or code == Cmd.UPLOAD), one.hex()
            if first[0] == 0xFE:
                assert len(first) == 2 and Err(first[1]) is not None
            elif code in (Cmd.CONNECT, Cmd.DISCONNECT):
                connected = code == Cmd.CONNECT
        written += sum(sent[:2] == b"\xfd\xfe" for sent in turn.cycle)
        measured += sum(sent[0] < 32 for sent in turn.cycle)
        assert len(turn.cycle) <= 33 and all(
            sent[0] < 32 or sent[:2] == b"\xfd\xfe" for sent in turn.cycle
        )
    assert written > 500 and measured > 5000, (written, measured)
    assert (table[0], table[1], table[4]) == (0.5, -1.25, 7.0)
    assert 0.0 <= table[2] <= 1000.0 and 0.0 <= table[3] <= 1000.0
