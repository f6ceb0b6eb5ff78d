"""A gateway that makes one CAN line of channels: the model of `drivers.line.line` on a clock.

What comes on one side waits in that side's transmit queue, and goes out on the others at the time
at which its last bit would be there. The model's tick 0 is the start of the gateway; a frame counts
as queued when it is read. Deadlines are absolute: a late wake-up delays one frame, not the line.
What is measured is the time at which the other side had taken a frame, behind that deadline.
"""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import wire
from pcpc.drivers.can.wire_layout import Arrival, Medium, Wire
from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import i8, loop, loop_function
from pcpc.drivers.compiled.records import Cells, Record, cells
from pcpc.drivers.compiled.structures import copy, structure
from pcpc.drivers.errors import BusError
from pcpc.drivers.line import error_frames, line
from pcpc.drivers.line.line import SENDERS, Line, Outcome
from pcpc.drivers.line.ticks import ns_of, tick_at
from pcpc.executive.loop.clock import machine_ns
from pcpc.executive.nodes.player import DOUBLINGS, FINE, PlayerControl, error_us, note

_LONGEST_SLEEP_NS = 50_000_000  # between two looks at the stop word
_READ_AT_ONCE = 64  # frames of a side; then what is due goes first


class GatewayMemory(Record):
    """What the loop has."""

    control: PlayerControl
    bins: Cells[int] = cells(FINE * (DOUBLINGS + 2))
    timespec: Cells[int] = cells(2)
    sides: int
    polled: Cells[int] = cells(SENDERS)  # of struct pollfd, as in Wire
    start_ns: int
    until: int  # the tick up to which the model is
    foreign: Cells[int] = cells(SENDERS)  # no CAN, remote, FD on a classic line
    line: Line
    side: Cells[Wire] = cells(SENDERS)


N = structure(GatewayMemory.dtype)


@loop_function
def _read(n: Any, end: Any, s: Any) -> Any:
    """Queue what has come on a side; return False if its bus failed."""
    for _ in range(_READ_AT_ONCE):
        arrival = wire.get_frame(end, False)
        if arrival == Arrival.FRAME:
            line.put(n.line, s, end.rx, n.until)
        elif arrival == Arrival.FOREIGN:
            n.foreign[s] += 1
        elif arrival == Arrival.FAILED:
            n.control.errno = end.errno
            return False
        elif arrival == Arrival.NOTHING:
            break
    return True


@loop_function
def _hand_over(n: Any, end: Any) -> None:
    """Put the frame that is through on the other side, and note how late that is."""
    copy(end.tx, n.line.frame)
    if not wire.put_frame(end):
        n.control.errors += 1
        n.control.errno = end.errno
    late = machine_ns(n) - n.start_ns - ns_of(n.line.per_s, n.line.at)
    note(n, max(late, np.int64(0)))


@loop_function
def _go_on(n: Any) -> None:
    """Let the line go on to tick `until`."""
    outcome = line.advance(n.line, n.until)
    while outcome != Outcome.NOTHING:
        if outcome == Outcome.SENT:
            for s in range(n.sides):
                if s != n.line.who and line.hears(n.line, s):
                    _hand_over(n, n.side[s])
        if n.side[0].kind == Medium.SOCKETCAN:  # udp_multicast carries no error frames to us
            for s in range(n.sides):
                if error_frames.news(n.line, s, n.side[s].tx):
                    wire.put_frame(n.side[s])
        outcome = line.advance(n.line, n.until)


@loop_function
def _sleep(n: Any) -> None:
    """Wait for a frame, or until something is due."""
    passed = machine_ns(n) - n.start_ns
    due = line.next_due(n.line)
    soonest = passed + _LONGEST_SLEEP_NS
    if due <= tick_at(n.line.per_s, soonest):
        soonest = ns_of(n.line.per_s, due)
    n.timespec[0], n.timespec[1] = 0, max(soonest - passed, np.int64(0))
    for s in range(n.sides):
        n.polled[s] = n.side[s].fd_rx | libc.POLLIN << 32
    libc.ppoll(libc.address(n.polled), n.sides, libc.address(n.timespec), 0)


@loop(i8(N))
def carry(n: Any) -> Any:
    """Carry frames until the stop word; return 0 if a bus failed."""
    if n.start_ns == 0:
        n.start_ns = machine_ns(n)
    while True:
        n.until = max(n.until, tick_at(n.line.per_s, machine_ns(n) - n.start_ns))
        _go_on(n)
        for s in range(n.sides):
            if not _read(n, n.side[s], s):
                return np.int64(0)
        line.close(n.line, n.until)
        if libc.load_acquire(n.control, "stop") != 0:
            return np.int64(1)
        _sleep(n)


class Gateway:
    """A gateway between buses; `carry` runs in a thread of the caller until `stop`."""

    def __init__(self, room: int, fd: bool = False, sides: int = 2, **options: Any) -> None:
        """`fd`: frames of CAN FD are carried too; `options` of `drivers.line.line.prepare`."""
        self._fd, self._sides = fd, sides
        self.n = self._block(room, options)
        dry = self._block(room, options)  # compiled, loaded, touched
        for s in range(sides):
            wire.prepare(dry.side[s], Medium.MEMORY, -1, -1)
        dry.control.stop = 1
        carry(dry)

    def _block(self, room: int, options: dict[str, Any]) -> Any:
        n: Any = np.zeros(1, GatewayMemory.dtype).view(np.recarray)[0]
        n.sides = self._sides
        line.prepare(n.line, self._sides, room, **options)
        return n

    def open(self, sides: Sequence[buses.BusAddress]) -> None:
        """Open all sides, which are heard from now on; BusError."""
        for bus, end in zip(sides, self.n.side, strict=False):
            end.fd = self._fd
            buses.open_bus(bus, None, end)
            buses.set_own_address(end)

    def carry(self) -> None:
        """Carry frames until `stop`; BusError."""
        if not carry(self.n):
            raise BusError(f"the gateway ends: {os.strerror(int(self.n.control.errno))}")

    def stop(self) -> None:
        """Ask `carry`, in another thread, to return."""
        self.n.control.stop = 1

    @property
    def passed_s(self) -> float:
        """How far the line is."""
        return int(self.n.until) / int(self.n.line.per_s)

    def late_us(self) -> dict[str, float]:
        """Return how late frames were handed over."""
        shares = {"p50": 0.5, "p99": 0.99}
        return {name: error_us(self.n, share) for name, share in shares.items()} | {
            "max": 1e-3 * int(self.n.control.max_ns)
        }

    @property
    def not_taken(self) -> int:
        """Frames that the other side did not take."""
        return int(self.n.control.errors)
