"""XCP on CAN: a packet a frame, one id from the master and one to it, and a budget of frames.

In no ten cycles (`Xcp.CYCLES`) more than `frames` are sent, answers first, nor more than a quarter
as many commands taken: so a master that waits for answers sends no more. Lists that ask for more
than the rest are refused at their start. A frame of CAN FD is padded to a length that there is.
"""

import math
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from pcpc.drivers.can import can_id, plain_bus
from pcpc.drivers.can.wire_layout import LENGTHS
from pcpc.executive.rig.bus_keys import Xcp
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.executive.rig.xcp import xcp_flags, xcp_ids
from pcpc.tools.live.xcp.packets import EV_DAQ_OVERLOAD, EV_SESSION_TERMINATED, EVENT, Link
from pcpc.tools.live.xcp.slave import XcpSession

BUSY_S, IDLE_S = 0.002, 0.05  # between looks at the bus, with a master and without
MOST_COMMANDS, MOST_LATE = 256, 4096


@dataclass(frozen=True)
class CanPlace:
    """How a node's slave is on a bus: ids down and up, its budget in a time, bit rates."""

    ids: tuple[int, int]
    flags: int
    budget: Xcp
    time_s: float
    rates: tuple[int | None, int | None]

    @classmethod
    def of(cls, rig: Rig, role: Role) -> "CanPlace | None":
        """Return that of a node; None without XCP on CAN. RigError."""
        config = rig.config
        if config.xcp_on_can is None:
            return None
        time_s = 1e-9 * config.period_ns * Xcp.CYCLES
        rates = config.bus.bits_per_s, config.bus.data_bitrate
        return cls(xcp_ids(rig)[role], xcp_flags(rig), config.xcp_on_can, time_s, rates)

    @property
    def link(self) -> Link:
        """What a session may send."""
        size = 64 if self.flags else 8
        listed = self.budget.frames - self.budget.commands
        return Link(
            size,
            size,
            listed / Xcp.CYCLES,
            min(255, math.ceil(1e4 * self.time_s / self.budget.commands)),
        )

    def __str__(self) -> str:
        down, up = self.ids
        kind = " FD" * bool(self.flags)
        return f"XCP over CAN{kind}, id 0x{down:X} to it, 0x{up:X} from it"

    def a2l(self) -> Iterator[str]:
        """Yield its lines of an A2L file."""
        (down, up), (nominal, fast) = (map(_word, self.ids), self.rates)
        yield f"      /begin XCP_ON_CAN 0x0101 CAN_ID_MASTER 0x{down:X} CAN_ID_SLAVE 0x{up:X}"
        yield "        MEASUREMENT_SPLIT_ALLOWED" + (f" BAUDRATE {nominal}" if nominal else "")
        if self.flags:
            rate = f" CAN_FD_DATA_TRANSFER_BAUDRATE {fast}" if fast else ""
            yield f"        /begin CAN_FD MAX_DLC 64{rate}\n        /end CAN_FD"
        yield "      /end XCP_ON_CAN"


class CanMaster:
    """The master of a slave on CAN, and what it has not got yet."""

    def __init__(
        self, place: CanPlace, bus: plain_bus.Udp | plain_bus.Can, session: XcpSession
    ) -> None:
        self.session, self.lost = session, False
        self._place, self._bus = place, bus
        self._down, self._up = map(_word, place.ids)
        self._commands, self._answers, self._late = deque[bytes](), deque[bytes](), deque[bytes]()
        self._taken_s = _times(place.budget.commands)
        self._sent_s = _times(place.budget.frames)

    @property
    def wait_s(self) -> float:
        """How long there is nothing to do."""
        wait_s = BUSY_S if self.session.connected else IDLE_S
        ago = time.monotonic() - self._place.time_s
        if self._commands:
            wait_s = min(wait_s, self._taken_s[0] - ago)
        if self._answers or self._late:
            wait_s = min(wait_s, self._sent_s[0] - ago)
        return max(wait_s, 0.0)

    def send(self, packets: list[bytes]) -> None:
        """Send packets of lists, or drop and tell them if too many wait."""
        if len(self._late) > MOST_LATE:
            packets, self.lost = [], True
        elif self.lost and packets:
            self._answers.append(bytes([EVENT, EV_DAQ_OVERLOAD]))
            self.lost = False
        self._late += packets

    def flush(self) -> None:
        """Answer, and send on what waits, as the budget allows; OSError, BusError."""
        for frame in self._bus.frames():
            if frame.word == self._down and len(self._commands) < MOST_COMMANDS:
                self._commands.append(frame.data)
        while self._commands and self._may(self._taken_s):
            self._taken_s.append(time.monotonic())
            self._answers += self.session.answers(self._commands.popleft())
            if not self.session.daq.running:
                self._late.clear()
        while (waiting := self._answers or self._late) and self._may(self._sent_s):
            if not self._bus.offer(self._up, _padded(waiting[0]), self._place.flags):
                break
            waiting.popleft()
            self._sent_s.append(time.monotonic())

    def _may(self, times_s: deque[float]) -> bool:
        return time.monotonic() >= times_s[0] + self._place.time_s

    def end(self) -> None:
        """Tell the master, if there is one, that nothing follows."""
        if self.session.connected:
            self._answers = deque([bytes([EVENT, EV_SESSION_TERMINATED])])
            time.sleep(self._place.time_s)
            self.flush()


def _times(count: int) -> deque[float]:
    return deque([-math.inf] * count, count)


def _word(number: int) -> int:
    return can_id.word_of(number, number > 0x7FF)


def _padded(packet: bytes) -> bytes:
    return packet.ljust(next(length for length in LENGTHS if length >= len(packet)), b"\0")
