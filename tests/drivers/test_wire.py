"""The wire formats: python-can datagrams both ways, hostile buffers, virtual-time queues.

Packets lie directly before an unreadable page: one byte read behind the end is a crash when
compiled, an IndexError when interpreted.
"""

import ctypes
import errno
import math
import mmap
import os
import random
import socket
import subprocess
import sys
from typing import Any

import can
import numpy as np
import pytest
import wires
from can.interfaces.udp_multicast.utils import pack_message, unpack_message
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from places import ROOT

from pcpc.drivers.can import wire, wire_layout
from pcpc.drivers.can.wire_layout import LENGTHS, Arrival, Flag, Medium, flags_of
from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import LOOP_INTERPRETED

HOSTILE_BUFFERS = 500 if LOOP_INTERPRETED else 20_000
EXAMPLES = 40 if LOOP_INTERPRETED else 300
PAGE = mmap.PAGESIZE
PROT_NONE = 0

Bytes = NDArray[np.uint8]


def guarded_page() -> Bytes:
    """Return one page whose next page cannot be touched."""
    pages = mmap.mmap(-1, 2 * PAGE)
    memory = np.frombuffer(pages, np.uint8)
    mprotect = ctypes.CDLL(None, use_errno=True).mprotect
    mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    assert mprotect(memory.ctypes.data + PAGE, PAGE, PROT_NONE) == 0, os.strerror(
        ctypes.get_errno()
    )
    return memory[:PAGE]


GUARDED = guarded_page()
PACKET = np.zeros(wire_layout.PACKET_BYTES, np.uint8)
PACKET[: wire.TEMPLATE_BYTES] = np.frombuffer(wire.TEMPLATE, np.uint8)


def new_wire(kind: int = Medium.MEMORY) -> Any:
    """Return a zeroed Wire record, prepared for `kind`."""
    end = wires.new_wire()
    wire.prepare(end, kind, -1, -1)
    return end


def frame(can_id: int, data: bytes, extended: bool = False, flags: int = Flag.NONE) -> Bytes:
    """Return struct canfd_frame."""
    word = can_id | int(extended) << 31
    packed = word.to_bytes(4, "little") + bytes([len(data), flags, 0, 0]) + data.ljust(64, b"\0")
    return np.frombuffer(packed, np.uint8).copy()


def content(received: Bytes) -> tuple[int, bool, bytes, int]:
    """Return id, extended, data and flags of a frame; fail if it is not a clean one."""
    word, n = int.from_bytes(received[:4].tobytes(), "little"), int(received[4])
    can_id, extended = word & 0x1FFFFFFF, bool(word >> 31)
    assert can_id <= (0x1FFFFFFF if extended else 0x7FF), f"id {can_id:#x}, extended {extended}"
    assert word >> 29 in (0, 4), f"flags in {word:#010x}"
    flags, past = int(received[5]), 72 if received[5] else 16
    assert flags == 0 or flags & Flag.FD, f"flags {flags}"
    assert n in LENGTHS[: LENGTHS.index(past - 8) + 1] and not received[8 + n : past].any(), n
    return can_id, extended, received[8 : 8 + n].tobytes(), flags


def read(packet: bytes) -> tuple[int, bool, bytes, int] | None:
    """Return what `_read_packet` makes of a packet that ends where the readable memory ends."""
    view = GUARDED[PAGE - len(packet) :]
    view[:] = np.frombuffer(packet, np.uint8)
    received = np.full(wire_layout.FRAME_BYTES, 0xEE, np.uint8)
    return content(received) if wire._read_packet(view, len(packet), received, 0) else None


IDS = st.one_of(
    st.tuples(st.integers(0, 0x7FF), st.just(False)),
    st.tuples(st.integers(0, 0x1FFFFFFF), st.just(True)),
)


@st.composite
def messages(draw: st.DrawFn) -> can.Message:
    """Draw any message that python-can can put on a bus."""
    can_id, extended = draw(IDS)
    kind = draw(st.sampled_from(["data", "data", "remote", "error", "fd"]))
    longest = {"remote": 0, "fd": 64}.get(kind, 8)
    data = draw(st.binary(max_size=8) | st.sampled_from([12, 16, 20, 24, 32, 48, 64]).map(bytes))
    return can.Message(
        timestamp=draw(st.floats(0, 1e12) | st.integers(0, 2**63)),
        arbitration_id=can_id,
        is_extended_id=extended,
        is_remote_frame=kind == "remote",
        is_error_frame=kind == "error",
        is_fd=kind == "fd",
        bitrate_switch=kind == "fd" and draw(st.booleans()),
        channel=draw(st.none() | st.text(max_size=40) | st.integers(0, 300)),
        data=data[:longest],
        check=True,
    )


@given(IDS, st.binary(max_size=64), st.sampled_from([0, 0, 4, 5, 6, 7]))
@settings(max_examples=EXAMPLES, deadline=None)
def test_python_can_reads_what_we_write(
    identity: tuple[int, bool], data: bytes, flags: int
) -> None:
    can_id, extended = identity
    data = data[: max(n for n in LENGTHS if n <= len(data) and (flags or n <= 8))]
    n = wire._write_packet(frame(can_id, data, extended, flags), PACKET)
    message = unpack_message(PACKET[:n].tobytes(), check=True)
    got = (message.arbitration_id, message.is_extended_id, bytes(message.data), message.dlc)
    assert got == (can_id, extended, data, len(data)), f"{got}"
    assert not (message.is_remote_frame or message.is_error_frame), f"{message}"
    assert flags_of(message) == flags, f"{message}"
    back = read(PACKET[:n].tobytes())
    assert back == (can_id, extended, data, flags), f"read back as {back}"


@given(messages())
@settings(max_examples=EXAMPLES, deadline=None)
def test_we_read_the_data_frames_of_python_can_and_no_others(message: can.Message) -> None:
    data = not (message.is_remote_frame or message.is_error_frame)
    sent = (message.arbitration_id, message.is_extended_id, bytes(message.data), flags_of(message))
    got = read(pack_message(message))
    assert got == (sent if data else None), f"{message} read as {got}"


def test_a_node_that_wants_them_takes_remote_frames_too() -> None:
    theirs, ours = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with theirs, ours:
        end = new_wire(Medium.UDP)
        end.fd_rx, end.own[:] = ours.fileno(), -1
        for wanted, arrival in ((0, Arrival.FOREIGN), (1, Arrival.FRAME)):
            end.remotes = wanted
            theirs.send(
                pack_message(
                    can.Message(arbitration_id=0x705, is_extended_id=False, is_remote_frame=True)
                )
            )
            assert wire.get_frame(end, False) == arrival
        assert bytes(end.rx[:5]) == (0x705 | 1 << 30).to_bytes(4, "little") + b"\0"
        theirs.send(pack_message(can.Message(arbitration_id=1, is_error_frame=True)))
        assert wire.get_frame(end, False) == Arrival.FOREIGN


@pytest.mark.parametrize("length", sorted({*range(66)} - {*LENGTHS}))
def test_a_length_that_can_fd_has_not_is_refused(length: int) -> None:
    message = can.Message(arbitration_id=1, data=bytes(length), is_fd=True, check=False)
    assert read(pack_message(message)) is None


@pytest.mark.parametrize(("fd", "arrival"), [(0, Arrival.FOREIGN), (1, Arrival.FRAME)])
def test_a_rig_without_can_fd_takes_its_frames_for_foreign_ones(fd: int, arrival: int) -> None:
    theirs, ours = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with theirs, ours:
        end = new_wire(Medium.UDP)
        end.fd_rx, end.fd, end.own[:] = ours.fileno(), fd, -1
        for is_fd in (True, False):
            message = can.Message(arbitration_id=1, data=bytes(8), is_fd=is_fd)
            theirs.send(pack_message(message))
        assert wire.get_frame(end, False) == arrival
        assert wire.get_frame(end, False) == Arrival.FRAME and end.rx[5] == Flag.NONE


@pytest.mark.parametrize(
    ("can_id", "extended", "length"),
    [(0x800, False, 8), (0x20000000, True, 8), (0x123, False, 9), (0x123, False, 64)],
)
def test_impossible_ids_and_lengths_are_refused(can_id: int, extended: bool, length: int) -> None:
    message = can.Message(
        arbitration_id=can_id, is_extended_id=extended, data=bytes(length), check=False
    )
    got = read(pack_message(message))
    assert got is None, f"{message} read as {got}"


def test_a_frame_that_claims_more_than_eight_bytes_carries_no_memory_behind_it() -> None:
    view = GUARDED[PAGE - wire_layout.FRAME_BYTES :]
    for length in range(9, 256):
        view[:] = frame(0x123, b"abcdefgh")
        view[4] = length
        n = wire._write_packet(view, PACKET)
        got = read(PACKET[:n].tobytes())
        assert got == (0x123, False, b"abcdefgh", 0), f"length {length} read as {got}"


def test_no_truncation_of_a_packet_is_a_frame() -> None:
    n = int(wire._write_packet(frame(0x12345678, b"abcdefgh", True), PACKET))
    packet = PACKET[:n].tobytes()
    for length in range(n):
        assert read(packet[:length]) is None, f"{length} of {n} bytes taken for a frame"
    assert read(packet + b"\0") is None, "a byte too many taken for a frame"


def test_random_buffers_are_survived_and_refused() -> None:
    rng = random.Random(1)
    taken = 0
    for _ in range(HOSTILE_BUFFERS):
        body = rng.randbytes(rng.randrange(wire_layout.PACKET_BYTES))
        taken += read(bytes([0x80 | rng.randrange(16)]) + body) is not None
    assert taken == 0, f"{taken} of {HOSTILE_BUFFERS} taken for frames"


def mutated(rng: random.Random, packet: bytes) -> bytes:
    """Return `packet` with some bytes changed and perhaps a piece cut out, doubled or cut off."""
    changed = bytearray(packet)
    for _ in range(rng.randrange(4)):
        changed[rng.randrange(len(changed))] = rng.choice(
            [rng.randrange(256), 0xC4, 0xD9, 0xFF, 0xCE, 0xCF, 0xC3, 0xA4]
        )
    at, n = rng.randrange(len(changed)), rng.randrange(1, 12)
    what = rng.randrange(6)
    if what == 0:
        del changed[at : at + n]
    elif what == 1:
        changed[at:at] = changed[at : at + n]
    elif what == 2:
        del changed[at:]
    return bytes(changed)


def test_mutated_packets_are_survived_and_read_as_python_can_reads_them() -> None:
    rng = random.Random(2)
    taken = compared = 0
    for _ in range(HOSTILE_BUFFERS):
        data = rng.randbytes(rng.randrange(9))
        message = can.Message(arbitration_id=rng.randrange(0x800), data=data, is_extended_id=False)
        packet = mutated(rng, pack_message(message))
        got = read(packet)
        if got is None:
            continue
        taken += 1
        try:
            theirs = unpack_message(packet, check=True)
        except (ValueError, TypeError):
            continue
        compared += 1
        assert got[0] == theirs.arbitration_id, f"{got} is not {theirs}: {packet!r}"
        assert got[2] == bytes(theirs.data), f"{got} is not {theirs}: {packet!r}"
    assert compared > HOSTILE_BUFFERS / 20, f"only {compared} compared, {taken} taken"


def test_frames_in_memory_arrive_in_order_and_unchanged_over_many_turns_of_the_queue() -> None:
    source, target = new_wire(), new_wire()
    sent, received = [], []
    for turn in range(60):
        for k in range(turn % 11):
            source.tx[:] = frame(turn, bytes([turn, k]))
            sent.append(source.tx.tobytes())
            assert wire.put_frame(source), f"refused at turn {turn}"
        wire.carry(source, target)
        while wire.get_frame(target, True) == Arrival.FRAME:
            received.append(target.rx.tobytes())
    assert received == sent, f"{len(sent)} sent, {len(received)} received"
    assert len(sent) > wire_layout.QUEUE_FRAMES, f"only {len(sent)} frames"
    assert wire.get_frame(source, True) == Arrival.NOTHING, "a sender must not hear itself"


def test_a_full_memory_wire_refuses_and_overwrites_nothing() -> None:
    source, target = new_wire(), new_wire()
    accepted = 0
    for k in range(3 * wire_layout.QUEUE_FRAMES):
        source.tx[:] = frame(accepted, b"")
        accepted += wire.put_frame(source)
        if k % 100 == 0:
            wire.carry(source, target)
    received = []
    for _ in range(2):
        while wire.get_frame(target, False) == Arrival.FRAME:
            received.append(content(target.rx)[0])
        wire.carry(source, target)
    capacity = 2 * wire_layout.QUEUE_FRAMES
    assert accepted == capacity, f"{accepted} accepted, room for {capacity}"
    assert received == list(range(accepted)), f"{len(received)} of {accepted} in order"


def test_frames_for_two_buses_in_memory_are_dealt_by_their_ids() -> None:
    source, first, second = new_wire(), new_wire(), new_wire()
    source.second[:2], source.n_second = (0x9ABCDEF0, 7), 2
    sent = [frame(7, b"7"), frame(1, b"1"), frame(0x1ABCDEF0, b"x", True), frame(0x1ABCDEF0, b"")]
    for one in sent:
        source.tx[:] = one
        assert wire.put_frame(source)
    wire.deal(source, first, second)
    assert source.outbox_put == 0
    for end, these in ((second, (sent[0], sent[2])), (first, (sent[1], sent[3]))):
        for one in these:
            assert wire.get_frame(end, False) == Arrival.FRAME and (end.rx == one).all()
        assert wire.get_frame(end, False) == Arrival.NOTHING
    for k in range(wire_layout.QUEUE_FRAMES + 1):
        wire.deliver(frame(k, b""), first)
    assert first.inbox_put - first.inbox_taken == wire_layout.QUEUE_FRAMES, "one more is lost"


def test_what_lies_behind_the_data_is_blanked() -> None:
    for length in (0, 7, 64, 255):
        one = np.full(wire_layout.FRAME_BYTES, 0xEE, np.uint8)
        one[4] = length
        wire.blank(one)
        kept = 8 + min(length, 64)
        assert (one[5:kept] == 0xEE).all() and not one[kept:].any(), length


def test_a_closed_descriptor_fails_with_its_error_number() -> None:
    closed = new_wire(Medium.UDP)
    assert not wire.put_frame(closed)
    assert closed.errno == 9, f"errno {closed.errno}, not EBADF"
    closed.errno = 0
    got = wire.get_frame(closed, False)
    assert got == Arrival.FAILED and closed.errno == 9, f"{got}, errno {closed.errno}"


def test_a_kind_that_nobody_wrote_fails_both_ways() -> None:
    unknown = new_wire(max(Medium.UDP, Medium.PYTHON_CAN) + 1)
    assert not wire.put_frame(unknown) and unknown.errno == errno.EPROTONOSUPPORT
    unknown.errno = 0
    for block in (False, True):
        assert wire.get_frame(unknown, block) == Arrival.FAILED
        assert unknown.errno == errno.EPROTONOSUPPORT


def test_a_wire_holds_what_its_numbers_promise() -> None:
    assert math.log2(wire_layout.QUEUE_FRAMES).is_integer()
    longest = pack_message(
        can.Message(arbitration_id=0x1FFFFFFF, data=bytes(64), is_fd=True, channel="udp_multicast")
    )
    assert len(longest) < wire_layout.PACKET_BYTES, f"python-can writes {len(longest)} bytes"
    assert libc.EAGAIN == 11


if not LOOP_INTERPRETED:

    def test_all_of_this_holds_interpreted() -> None:
        runs = {
            "PCPC_LOOP=interpreted": ["test_wire.py", "test_bus.py", "test_libc.py"],
            "NUMBA_DISABLE_JIT=1": ["test_wire.py", "test_libc.py"],
        }
        pytest_command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]
        processes = {
            switch: subprocess.Popen(
                [*pytest_command, *(f"tests/drivers/{file}" for file in files)],
                cwd=ROOT,
                env={**os.environ, **dict([switch.split("=")])},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
            for switch, files in runs.items()
        }
        for switch, process in processes.items():
            output, _ = process.communicate(timeout=120)
            assert process.returncode == 0, f"{switch}\n{output[-3000:]}"


@pytest.mark.parametrize("fd", [0, 1])
@pytest.mark.parametrize("kind", [Medium.SOCKETCAN, Medium.UDP])
def test_a_frame_is_what_a_log_has_of_it(kind: int, fd: int) -> None:
    """A keyframe has whole frames: padding, which no log keeps, would differ in replay."""
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with here, there:
        taker = new_wire(kind)
        taker.fd_rx, taker.fd, taker.own[:] = here.fileno(), fd, -2
        for data, flags in ((bytes(range(64)), Flag.FD), (b"\x01\x02\x03", Flag.NONE)):
            if kind == Medium.SOCKETCAN and flags and not fd:
                continue  # the kernel gives such a socket no FD frame
            if kind == Medium.UDP:
                message = can.Message(
                    arbitration_id=0x123, data=data, is_extended_id=False, is_fd=bool(flags)
                )
                there.send(pack_message(message))
            else:
                raw = frame(0x123, data, flags=flags)
                raw[6:8] = 7, 8  # struct can_frame: reserved, len8_dlc, as python-can sends it
                there.send(raw[: 72 if flags else 16].tobytes())
            came = wire.get_frame(taker, True)
            assert came == (Arrival.FRAME if fd or not flags else Arrival.FOREIGN), data
        assert taker.rx[:16].tobytes() == frame(0x123, b"\x01\x02\x03")[:16].tobytes()
