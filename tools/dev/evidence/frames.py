"""Random and mutated frames: through a socket into the loop's own parser and acceptance.

Two formats: `struct can_frame` of SocketCAN, as the kernel hands it to a raw socket, and the
msgpack datagram of python-can's udp_multicast, sent to a real UDP socket. Before each frame the
receiver is set back: it has heard counter LAST of every frame. What became of the frame follows
from what the wire returned and from the counters of the loop, of which it has to move one; what was
used, and some of the rest, is judged again by the rules in plain Python (`evidence.expected`).
"""

import math
import random
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any, NamedTuple

import can
import numpy as np
from can.interfaces.udp_multicast.utils import pack_message
from numpy.typing import NDArray

from pcpc.drivers.can import e2e, wire
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.can.wire_layout import CLASSIC_BYTES, FRAME_BYTES, PACKET_BYTES, Arrival, Medium
from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.structures import words
from pcpc.executive.loop import control, reception
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.dev.evidence import expected
from pcpc.tools.start import rigs

FATES = ("lost", "used", "no data frame", "bus error", "another id", "own id", "ERROR", "REPEATED",
         "WRONG_SEQUENCE", "counted twice")  # fmt: skip
LOST, USED, NO_FRAME, TOLD, OTHER, OWN, WRONG, AGAIN, AHEAD, TWICE = range(len(FATES))
LAST, NEXT, DLC = 7, 8, 8  # the counter heard, the next one; bytes of the frame
_AT_ONCE, _SAMPLE, _WAIT_S = 20_000, 100, 1.0  # one in _SAMPLE of the others is judged again
_COUNTED = "received", "crc_errors", "repeated", "wrong_sequence", "foreign"
_COUNTS = np.array([control.place(word) for word in _COUNTED])
_FATE_OF_STATE: dict[int, int] = {
    FrameState.ERROR: WRONG, FrameState.REPEATED: AGAIN, FrameState.WRONG_SEQUENCE: AHEAD,
}  # fmt: skip
_FATE_OF = np.array([USED, WRONG, AGAIN, AHEAD, OWN])
Draw = Callable[[random.Random, "Good"], bytes]


@loop_function
def feed_packets(
    n: Any, fd: Any, packets: Any, lengths: Any, state: Any, counts: Any, told: Any
) -> None:
    """Send each packet, take it, write what the wire returned, what was counted, and the frame."""
    for s in range(lengths.shape[0]):
        for row in range(state.shape[0]):
            n.rx.source[row] = 0
            for i in range(state.shape[1]):
                words(n.rx.state[row])[i] = state[row, i]
        for streak in (n.rx.foreign, n.rx.repeats):
            streak.since, streak.count = 0, 0
        n.guard.faulted = 0
        for i in range(counts.shape[0]):
            words(n.control)[counts[i]] = 0
        for i in range(FRAME_BYTES):
            n.wire.rx[i] = 0
        n.frame_taken[0], n.event_taken[0] = n.frame_ends.head, n.event_ends.head
        libc.send(fd, libc.address(packets[s]), lengths[s], libc.MSG_DONTWAIT)
        told[s, 0] = reception.take(n, True)
        for i in range(counts.shape[0]):
            told[s, 1 + i] = words(n.control)[counts[i]]
        for i in range(FRAME_BYTES):
            told[s, 1 + counts.shape[0] + i] = n.wire.rx[i]


class Good(NamedTuple):
    """The frame that would be used, and those that the receiver knows."""

    can_id: int
    known: Mapping[int, expected.Protection]
    others: Sequence[int]  # ids of 11 bits

    def data(self, draw: random.Random, counter: int = NEXT) -> bytes:
        """Return drawn data behind a counter, with its CRC."""
        return self.known[self.can_id].sent(draw.randbytes(DLC), counter)


def _wrong_data(draw: random.Random, data: bytes, bits: int) -> bytes:
    word = int.from_bytes(data, "little")
    for place in draw.sample(range(8 * len(data)), bits):
        word ^= 1 << place
    return word.to_bytes(len(data), "little")


def _byte(draw: random.Random, good: Good) -> bytes:
    """Return right data of which one byte is drawn anew."""
    data = bytearray(good.data(draw))
    data[draw.randrange(DLC)] = draw.randrange(256)
    return bytes(data)


DATA: Mapping[str, tuple[Draw, float]] = {  # what stands behind the right id; the share to be used
    "drawn data": (lambda draw, good: draw.randbytes(DLC), e2e.MAX_DELTA / 16 / 256),
    "any counter": (lambda draw, good: good.data(draw, draw.randrange(16)), e2e.MAX_DELTA / 16),
    "a byte drawn anew": (_byte, 1 / 256),
    "one wrong bit": (lambda draw, good: _wrong_data(draw, good.data(draw), 1), 0.0),
    "two wrong bits": (lambda draw, good: _wrong_data(draw, good.data(draw), 2), 0.0),
}


def _struct(word: int, data: bytes, length: int | None = None) -> bytes:
    size = len(data) if length is None else length
    return word.to_bytes(4, "little") + bytes([size, 0, 0, 0]) + data[:DLC].ljust(DLC, b"\0")


def _length(draw: random.Random) -> int:
    length = draw.randrange(255)
    return length + (length >= DLC)


def _datagram(can_id: int, data: bytes, **about: Any) -> bytes:
    return bytes(
        pack_message(
            can.Message(arbitration_id=can_id, data=data, **{"is_extended_id": False} | about)
        )
    )


def _behind_id(build: Callable[[int, bytes], bytes]) -> dict[str, tuple[Draw, float | None]]:
    """Return the kinds of DATA in a format."""

    def of(one: Draw) -> Draw:
        return lambda draw, good: build(good.can_id, one(draw, good))

    return {name: (of(one), share) for name, (one, share) in DATA.items()}


def _of_struct() -> dict[str, tuple[Draw, float | None]]:
    """Return the kinds of struct can_frame, and the share to be used."""
    return {
        "all 16 bytes drawn": (lambda draw, good: draw.randbytes(CLASSIC_BYTES), 0.0),
        **_behind_id(_struct),
        "another length": (lambda d, good: _struct(good.can_id, good.data(d), _length(d)), 0.0),
        "another id": (lambda d, good: _struct(d.choice(good.others), good.data(d)), 0.0),
        "extended, remote, error": (
            lambda d, good: _struct(good.can_id | d.randrange(1, 8) << 29, good.data(d)), 0.0
        ),
        "cut short": (
            lambda d, good: _struct(good.can_id, good.data(d))[: d.randrange(CLASSIC_BYTES)], 0.0
        ),
    }  # fmt: skip


def _of_datagram() -> dict[str, tuple[Draw, float | None]]:
    """Return the kinds of datagrams, and the share to be used; None: only what they may carry."""

    def whole(draw: random.Random, good: Good) -> bytes:
        return _datagram(good.can_id, good.data(draw))

    return {
        "all bytes drawn": (lambda draw, good: draw.randbytes(draw.randrange(PACKET_BYTES)), 0.0),
        "a map of drawn bytes": (
            lambda d, good: bytes([0x80 | d.randrange(16)]) + d.randbytes(d.randrange(300)), 0.0
        ),
        **_behind_id(_datagram),
        "a wrong bit anywhere": (lambda draw, good: _wrong_data(draw, whole(draw, good), 1), None),
        "three wrong bytes anywhere": (_three_bytes, None),
        "another length": (
            lambda d, good: _datagram(good.can_id, good.data(d)[: d.randrange(DLC)]), 0.0
        ),
        "another id": (lambda d, good: _datagram(d.choice(good.others), good.data(d)), 0.0),
        "extended, remote, error, FD": (_unlike, 0.0),
        "cut short": (lambda d, good: (one := whole(d, good))[: d.randrange(len(one))], 0.0),
        "bytes behind it": (lambda d, good: whole(d, good) + d.randbytes(d.randint(1, 80)), 0.0),
    }  # fmt: skip


def _three_bytes(draw: random.Random, good: Good) -> bytes:
    packet = bytearray(_datagram(good.can_id, good.data(draw)))
    for place in draw.sample(range(len(packet)), 3):
        packet[place] = draw.randrange(256)
    return bytes(packet)


def _unlike(draw: random.Random, good: Good) -> bytes:
    about: Any = draw.choice([
        {"is_extended_id": True}, {"is_remote_frame": True}, {"is_error_frame": True},
        {"is_fd": True}, {"is_fd": True, "bitrate_switch": True},
    ])  # fmt: skip
    data = good.data(draw) * (draw.choice([1, 2, 8]) if "is_fd" in about else 1)
    return _datagram(good.can_id, b"" if "is_remote_frame" in about else data, **about)


class Format(NamedTuple):
    """A format on the wire: its kind, its sockets, what is sent."""

    kind: int
    sockets: Callable[[], tuple[socket.socket, socket.socket]]
    kinds: Mapping[str, tuple[Draw, float | None]]


def _udp() -> tuple[socket.socket, socket.socket]:
    ends = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    ends[1].bind(("127.0.0.1", 0))
    ends[0].connect(ends[1].getsockname())
    return ends[0], ends[1]


@cache
def formats() -> Mapping[str, Format]:
    """Return the formats by name."""
    return {
        "struct can_frame": Format(
            Medium.SOCKETCAN,
            lambda: socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM),
            _of_struct(),
        ),
        "udp_multicast datagram": Format(Medium.UDP, _udp, _of_datagram()),
    }


@cache
def _node() -> Any:
    """Return the memory of an executive."""
    return VirtualRun(load_rig(rigs.find("hull")), None).blocks[0]


@contextmanager
def _connected_executive(one: Format) -> Iterator[tuple[Any, int]]:
    """Put the executive on a socket; yield it and the descriptor of the other end."""
    n, ends = _node().loop, one.sockets()
    ends[1].setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, np.array([int(_WAIT_S), 0]).tobytes())
    wire.prepare(n.wire, one.kind, -1, ends[1].fileno())
    n.wire.source, n.passes = 0, 1
    try:
        yield n, ends[0].fileno()
    finally:
        for end in ends:
            end.close()


def _known_frames(n: Any) -> Good:
    """Return the frames that the executive knows, as the rules in plain Python have them."""
    known = {}
    for row in n.rx.frames[: n.rx.n]:
        mask = row.counter_mask if row.protected else 0
        can_id, dlc, every_n = int(row.can_id), int(row.dlc), int(row.every_n)
        byte, shift = int(row.counter_byte), int(row.counter_shift)
        known[can_id] = expected.Protection(can_id, dlc, every_n, byte, shift, int(mask))
    can_id = next(one.can_id for one in known.values() if one.mask and one.dlc == DLC)
    return Good(can_id, known, [one for one in range(0x800) if one != can_id])


def fates_of_kind(name: str, kind: str, count: int, seed: int) -> dict[str, Any]:
    """Return what became of `count` frames of a kind."""
    one = formats()[name]
    make, share = one.kinds[kind]
    draw = random.Random(f"{seed}/{name}/{kind}")
    fates, misjudged = np.zeros(len(FATES), np.int64), 0
    with _connected_executive(one) as (n, fd):
        good = _known_frames(n)
        state = e2e.new_state(len(n.rx.state))
        state["last_counter"], state["still_cycles"] = LAST, 1
        receivers = state.view(np.int64).reshape(len(state), -1)
        for first in range(0, count, _AT_ONCE):
            sent = [make(draw, good) for _ in range(min(_AT_ONCE, count - first))]
            packets = np.zeros((len(sent), PACKET_BYTES), np.uint8)
            for row, packet in zip(packets, sent, strict=True):
                row[: len(packet)] = np.frombuffer(packet, np.uint8)
            lengths = np.array([*map(len, sent)], np.int64)
            told = np.zeros((len(sent), 1 + len(_COUNTS) + FRAME_BYTES), np.int64)
            feed_packets(n, fd, packets, lengths, receivers, _COUNTS, told)
            found = _fates(told)
            fates += np.bincount(found, minlength=len(FATES))
            misjudged += _misjudged_count(good, found, told[:, 1 + len(_COUNTS) :])
    used, spread = int(fates[USED]), 0.0
    if share is not None:
        spread = 5.0 * math.sqrt(count * share * (1.0 - share))
    kept = misjudged == fates[LOST] == fates[TWICE] == 0
    return {
        "format": name, "kind": kind, "frames": count, "predicted": share, "used": used,
        "fates": {fate: int(n) for fate, n in zip(FATES, fates, strict=True) if n},
        "misjudged": misjudged,
        "kept": bool(kept and (share is None or abs(used - count * share) <= spread)),
    }  # fmt: skip


def _fates(told: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return what became of each frame."""
    result, counts = told[:, 0], told[:, 1 : 1 + len(_COUNTS)]
    found = np.full(len(told), LOST)
    found[result == Arrival.FOREIGN] = NO_FRAME
    found[result == Arrival.BUS_ERROR] = TOLD
    found[result == Arrival.FRAME] = OTHER
    counted = counts.sum(1)
    which = _FATE_OF[counts.argmax(1)]
    found[counted > 0] = which[counted > 0]
    found[(counted > 1) | ((counted > 0) & (result != Arrival.FRAME))] = TWICE
    return found


def _misjudged_count(good: Good, fates: NDArray[np.int64], frames: NDArray[np.int64]) -> int:
    """Return how many frames the rules in plain Python judge in another way."""
    wrong = 0
    taken = np.isin(fates, (USED, OTHER, OWN, WRONG, AGAIN, AHEAD))
    chosen = taken & ((fates == USED) | (np.arange(len(fates)) % _SAMPLE == 0))
    for fate, frame in zip(fates[chosen].tolist(), frames[chosen].tolist(), strict=True):
        word = int.from_bytes(bytes(frame[:4]), "little")
        known = good.known.get(word)
        if known is None:
            wrong += fate not in (OTHER, OWN)
            continue
        receiver = expected.ExpectedReceiver(known)
        receiver.last, receiver.still = LAST, 1
        state = receiver.check(bytes(frame[8:]), frame[4])[0]
        wrong += fate != _FATE_OF_STATE.get(state, USED)
    return wrong


Task = tuple[str, str, int, int]


def task(one: Task) -> dict[str, Any]:
    """Return what became of the frames of a task."""
    return fates_of_kind(*one)


def tasks(frames: int, seed: int) -> Sequence[Task]:
    """Return the tasks of `frames` frames of each format, about as many of each kind."""
    return [
        (name, kind, math.ceil(frames / len(one.kinds)), seed)
        for name, one in formats().items()
        for kind in one.kinds
    ]
