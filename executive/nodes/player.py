"""Frames put on a bus at absolute deadlines: the compiled loop and what it measures.

    deadline of frame i in lap l = start + l lap + due[i]                              ns, monotonic
    timing error                 = time at which the bus had taken the frame - its deadline

A frame whose time is over goes at once: after a stall everything owed follows in order and the
later deadlines are unmoved, since a recording with gaps is worth less than an uneven one. A full
queue (ENOBUFS, EAGAIN) is waited for; any other refusal counts as a send error and the next frame
has its turn.

The errors go into bins 1 % wide, so that memory does not grow with time: `executive.loop.buckets`.
"""

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import wire
from pcpc.drivers.can.wire_layout import CLASSIC_BYTES, Arrival, Medium, Wire
from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import i8, loop, loop_function, types
from pcpc.drivers.compiled.records import Cells, Element, Record, cells, line
from pcpc.drivers.compiled.structures import copy, structure
from pcpc.executive.loop.buckets import end_of, place_of
from pcpc.executive.loop.clock import machine_ns

WITHIN_NS = 200_000  # the share of frames with an error up to here is counted exactly
FINE = 128  # bins to a doubling
DOUBLINGS = 40  # errors up to 39 hours


class PlayerControl(Element):
    """What it is told, and tells."""

    stop: int = line()  # the end is asked for, by another thread
    sent: int = line()
    errors: int
    errno: int
    waited: int
    within: int
    max_ns: int
    first_due: int
    first_sent: int
    last_due: int
    last_sent: int


_STOP_EVERY_NS = 50_000_000  # the longest sleep between two looks at the stop word
_QUEUE_POLL_NS = 100_000  # a frame of 8 bytes takes longer at 1 Mbit/s
_QUEUE_PATIENCE_NS = 200_000_000  # a bus that takes nothing for so long has nobody who acknowledges
_ENOBUFS = 105
_LEAD_NS = 2_000_000  # from the call to the first frame: the loop's thread is asleep by then


class PlayerMemory(Record):
    """What the loop has."""

    control: PlayerControl
    timed: int  # 0: there are no deadlines, everything goes as fast as the bus takes it
    refused: int  # the last frame was not taken: the next is tried once
    timespec: Cells[int] = cells(2)
    bins: Cells[int] = cells(FINE * (DOUBLINGS + 2))
    wire: Wire


N = structure(PlayerMemory.dtype)
FRAMES = types.Array(types.uint8, 2, "C")
TIMES = types.Array(types.int64, 1, "C")
_place_of = loop_function(place_of)


@loop_function
def _sleep_until(n: Any, deadline: Any) -> Any:
    """Sleep until `deadline`; return False if the stop word was set."""
    now_ns = machine_ns(n)
    while now_ns < deadline and libc.load_acquire(n.control, "stop") == 0:
        until = min(deadline, now_ns + _STOP_EVERY_NS)
        n.timespec[0] = until // 1_000_000_000
        n.timespec[1] = until % 1_000_000_000
        libc.clock_nanosleep(libc.CLOCK_MONOTONIC, libc.TIMER_ABSTIME, libc.address(n.timespec), 0)
        now_ns = machine_ns(n)
    return libc.load_acquire(n.control, "stop") == 0


@loop_function
def _send(n: Any, frame: Any) -> Any:
    """Hand over `frame` (16,), waiting while the bus's queue is full; return True once taken."""
    copy(n.wire.tx, frame)
    if wire.put_frame(n.wire):
        n.refused = 0
        return True
    give_up = machine_ns(n) + _QUEUE_PATIENCE_NS
    while n.refused == 0 and (n.wire.errno == libc.EAGAIN or n.wire.errno == _ENOBUFS):
        n.control.waited += 1
        at = machine_ns(n)
        if at > give_up or not _sleep_until(n, at + _QUEUE_POLL_NS):
            break
        if wire.put_frame(n.wire):
            return True
    n.refused = 1
    return False


@loop_function
def note(n: Any, error: Any) -> None:
    """Count one timing error, ns, in `control` and `bins`."""
    n.control.max_ns = max(n.control.max_ns, error)
    n.control.within += error <= WITHIN_NS
    n.bins[_place_of(error, FINE, DOUBLINGS)] += 1


@loop(i8(N, FRAMES, TIMES, i8, i8, i8))
def play(n: Any, frames: Any, due: Any, start: Any, lap: Any, laps: Any) -> Any:
    """Send `frames` (k, 16) at start + due (k,), `laps` times, 0 for ever; return frames taken."""
    taken = np.int64(0)
    done = np.int64(0)
    while laps == 0 or done < laps:
        for i in range(frames.shape[0]):
            deadline = start + done * lap + due[i]
            if not _sleep_until(n, deadline if n.timed != 0 else np.int64(0)):
                return taken
            if not _send(n, frames[i]):
                n.control.errors += 1
                n.control.errno = n.wire.errno
                continue
            sent_ns = machine_ns(n)
            if n.control.sent == 0:
                n.control.first_due = deadline
                n.control.first_sent = sent_ns
            n.control.last_due = deadline
            n.control.last_sent = sent_ns
            n.control.sent += 1
            taken += 1
            if n.timed != 0:
                note(n, max(sent_ns - deadline, np.int64(0)))
        done += 1
    return taken


@loop(i8(N, TIMES))
def hear(n: Any, ids: Any) -> Any:
    """Wait at most the receive time-out; return 1 for a frame of `ids`, 0 for none, -1: failed."""
    result = wire.get_frame(n.wire, True)
    if result == Arrival.FAILED:
        return np.int64(-1)
    if result != Arrival.FRAME:
        return np.int64(0)
    word = np.int64(0)
    for i in range(4):
        word |= np.int64(n.wire.rx[i]) << (8 * i)
    for known in ids:
        if word == known:
            return np.int64(1)
    return np.int64(0)


class Player:
    """A player with its frames (k, 16) uint8, due times (k,) ns and lap, ns; made, then opened."""

    def __init__(
        self, frames: NDArray[np.uint8], due_ns: NDArray[np.int64], lap_ns: int, *, timed: bool
    ) -> None:
        self.frames = np.array(frames, np.uint8, order="C")
        self.due_ns = np.array(due_ns, np.int64, order="C")
        self.lap_ns = lap_ns
        self.n = _block(timed)
        dry = _block(True)
        wire.prepare(dry.wire, Medium.MEMORY, -1, -1)
        play(dry, self.frames[:1], self.due_ns[:1], 0, 0, 1)  # compiled, loaded, touched

    def open(self, bus: buses.BusAddress, receive_ids: list[int]) -> None:
        """Open `bus`, listening to `receive_ids`; BusError."""
        self.n.wire.fd = self.frames.shape[1] > CLASSIC_BYTES
        buses.open_bus(bus, receive_ids, self.n.wire)

    def hear(self, ids: NDArray[np.int64]) -> bool:
        """Return whether one of `ids` (n,), with SocketCAN's flags, came within 0.1 s; OSError."""
        result = hear(self.n, ids)
        if result < 0:
            raise OSError(int(self.n.wire.errno), os.strerror(int(self.n.wire.errno)))
        return bool(result)

    def close_ears(self) -> None:
        """Hear nothing any more: on udp_multicast the frames sent would come back unread."""
        if self.n.wire.kind == Medium.UDP and self.n.wire.fd_rx >= 0:
            os.close(int(self.n.wire.fd_rx))
            self.n.wire.fd_rx = -1

    def soon_ns(self, period_ns: int, phase_ns: int) -> int:
        """Return a time to start that lies `phase_ns` behind a whole period of the clock."""
        soonest = int(machine_ns(self.n)) + _LEAD_NS - phase_ns
        return (soonest // period_ns + 1) * period_ns + phase_ns

    def play(self, start_ns: int, laps: int = 1) -> None:
        """Play everything `laps` times, 0 for ever, from `start_ns` on."""
        play(self.n, self.frames, self.due_ns, start_ns, self.lap_ns, laps)

    def play_part(self, first: int, end: int) -> None:
        """Play frames first to end - 1, at once, with their distances."""
        start = int(machine_ns(self.n)) - int(self.due_ns[first])
        play(self.n, self.frames[first:end], self.due_ns[first:end], start, 0, 1)

    def stop(self) -> None:
        """Ask the loop, in another thread, to return."""
        self.n.control.stop = 1

    def count(self, word: str) -> int:
        """Return a word of `control`."""
        return int(self.n.control[word])

    def error_us(self, share: float) -> float:
        """Return the timing error that `share` of the frames do not exceed, within 1 %."""
        return error_us(self.n, share)


def error_us(n: Any, share: float) -> float:
    """Return the timing error that `share` of what was noted does not exceed, within 1 %."""
    total = np.cumsum(n.bins)
    if total[-1] == 0:
        return 0.0
    place = int(np.searchsorted(total, share * total[-1]))
    return 1e-3 * min(end_of(place, FINE), int(n.control.max_ns))


def _block(timed: bool) -> Any:
    n: Any = np.zeros(1, PlayerMemory.dtype).view(np.recarray)[0]
    n.timed = timed
    return n
