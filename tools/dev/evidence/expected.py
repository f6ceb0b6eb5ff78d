"""What the safety code has to do, written a second time: in plain Python, from the documents.

    Supervised    supervisor, limits and watchdog of a node: docs/rig.md, docs/bus-safety.md
    Receiver      the judgement of received frames: the table of drivers/can/e2e.py, bitwise CRC
    packed        a frame's bytes: round half to even, saturate, place

The mutants of the compiled code are run against this; so are the tests of it.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from pcpc.drivers.can import dbc

TABLE = {  # state: what follows by event
    "INIT": {"fresh": "READY", "fault": "FAULT"},
    "READY": {"fresh": "RUN", "fault": "FAULT"},
    "RUN": {"missed": "HOLD", "fault": "FAULT", "disarmed": "READY"},
    "HOLD": {"fresh": "RUN", "fault": "FAULT", "disarmed": "READY"},
    "FAULT": {"ramped": "STOP", "reset": "INIT"},
    "STOP": {},
}
NUMBER = {name: number for number, name in enumerate(TABLE)}
HEARTBEAT = {"INIT": 127, "READY": 127, "RUN": 5, "HOLD": 5, "FAULT": 4, "STOP": 4}
MISSING, COMMAND_ODD, EMERGENCY = 1, 2, 12


@dataclass
class BoundedSignal:
    """A sent signal with bounds; `change` is what it may change in a cycle."""

    low: float
    high: float
    change: float
    safe: float
    sent: float = 0.0
    last: float = 0.0

    def __post_init__(self) -> None:
        self.sent = self.last = self.safe

    @property
    def settled(self) -> bool:
        """Whether it may be safe in the next frame."""
        return abs(self.sent - self.safe) <= self.change


@dataclass
class Settings:
    """Of an episode."""

    hold_cycles: int
    fault_after: int
    ramp: float
    quick: float
    waits: bool
    safe_start: bool
    clocked: bool
    cycles: int
    odd_output: int
    substitute: float
    manual: bool = False


@dataclass
class SupervisorModel:
    """A node's supervisor; `awaited` frames a cycle, of which `of_peer` also count at the end."""

    has: Settings
    commands: list[BoundedSignal]
    awaited: int
    of_peer: int
    state: str = "INIT"
    fault: int = 0
    told_fault: int = 0
    gain: float = 1.0
    pace: float = 0.0
    missing: int = 0
    held: int = 0
    stale: int = 0
    untaken: int = 0  # cycles in a row without input that nobody took on purpose
    starved: int = 0
    saturated: int = 0
    clamped: bool = False
    odd: tuple[int, int] = (0, 0)  # place + 1 and cycle of the first value that is none
    odd_bits: int = 0
    watched: float = 0.0
    held_input: float = 0.0
    stop: bool = False
    hurry: str = ""
    reset: bool = False
    disarmed: float = 0.0  # any number but 0
    hosts_stop: bool = False
    events: list[tuple[int, int]] = field(default_factory=list)

    def note(self, fault: int) -> None:
        """Take the first fault that is seen."""
        self.fault = self.fault or fault

    def supervise(
        self, k: int, fresh: int, pressed: float, told_state: float, taken: bool = False
    ) -> None:
        """Do a cycle: `told_state` of the node above, `pressed` the emergency stop.

        `taken`: what is missing was taken on purpose.
        """
        before = self.state
        asked = k >= self.has.cycles or self.hosts_stop or told_state == NUMBER["STOP"] or self.stop
        complete = fresh >= self.awaited
        self.missing = 0 if complete else self.missing + 1
        self.untaken = 0 if complete or taken else self.untaken + 1
        if not complete and before in ("RUN", "HOLD"):
            self.held += 1
            self.stale += self.missing > self.has.hold_cycles
            self.starved += self.untaken > self.has.hold_cycles
        silent = before != "INIT" and self.missing >= self.has.fault_after
        if silent and not asked:
            self.note(MISSING)
        if pressed != 0.0:
            self.note(EMERGENCY)
            self.hurry = self.hurry or "asked"
        safe = all(command.settled for command in self.commands)
        leave = asked and (safe or (silent and not self.has.clocked))
        ramped = self.gain <= 0.0 and safe
        granted = self._judge_reset(complete and ramped)
        self.state = self._next(complete, leave, ramped and not self.has.waits, granted)
        waits = self.disarmed and self.state == "READY"
        ramps = self.state in ("FAULT", "STOP") or asked or waits
        if before == "READY" and not ramps:
            self.pace = 0.0
        if ramps and (self.pace == 0.0 or self.hurry == "asked"):
            self._begin_ramp(asked)
        on_its_way = waits and before == "READY"
        if before in ("FAULT", "STOP") or (asked and not leave) or on_its_way:
            self.gain = max(self.gain - self.pace, 0.0)
        elif not ramps and self.state != "INIT":
            self.gain = min(self.gain + self.has.ramp, 1.0)
        if self.state != before:
            self.events.append((2, NUMBER[self.state]))
            if self.state == "FAULT":
                self.told_fault = self.fault
                self.events.append((1, self.fault))
                self.disarmed = 1.0 if self.has.manual else self.disarmed
        self._substitute()

    def _judge_reset(self, possible: bool) -> bool:
        asked, self.reset = self.reset, False
        if not asked:
            return False
        if possible and not self.fault:
            self.pace = 0.0
            return True
        self.fault = self.told_fault = self.fault or self.told_fault
        self.events.append((1, self.fault))
        return False

    def _next(self, complete: bool, leave: bool, ramped: bool, granted: bool) -> str:
        if leave:
            return "STOP"
        if self.state == "FAULT":
            event = "reset" if granted else "ramped" if ramped else ""
        else:
            event = "fresh" if complete else "missed"
            if self.fault or (self.disarmed and self.state != "INIT"):
                event = "fault" if self.fault else "disarmed"
        return TABLE[self.state].get(event, self.state)

    def _begin_ramp(self, asked: bool) -> None:
        self.pace = self.has.ramp
        if self.hurry:
            self.pace, self.hurry = self.has.quick, "begun"
        for one in self.commands:
            way = abs(one.last - one.safe)
            if way * self.pace > one.change:
                self.pace = one.change / way
        if asked:
            self.awaited = self.of_peer

    def _substitute(self) -> None:
        ramps = self.state in ("FAULT", "STOP")
        rises = not ramps and self.gain < 1.0 and self.pace == 0.0
        if not ramps and (not rises or self.missing == 0):
            self.held_input = self.watched
        if ramps or rises:
            safe = self.has.substitute
            self.watched = safe + self.gain * (self.held_input - safe)

    def hear(self, reset: float, stop: float, disarmed: float | None) -> None:
        """Take requests; `disarmed` is None where nothing is said of it."""
        self.disarmed = self.disarmed if disarmed is None else disarmed
        settled = all(command.settled for command in self.commands)
        safe = self.gain <= 0.0 and settled
        if reset and self.state == "FAULT" and self.has.waits and safe:
            self.reset, self.fault, self.hurry = True, 0, ""
        if stop:
            self.stop = True
            if stop > 1.0:
                self.hurry = self.hurry or "asked"

    def limit(self, k: int, outputs: Sequence[float], wishes: Sequence[float], at: int) -> None:
        """Bound what is sent; `at`: the place of the first wish, whose outputs lie behind."""
        values = [
            *zip(range(at + len(wishes), at + 9), outputs, strict=False),
            *enumerate(wishes, at),
        ]
        odd = [place for place, value in values if not math.isfinite(value) or abs(value) >= 1e300]
        if odd and not self.odd[0]:
            self.odd = odd[0] + 1, k
            value = dict(values)[odd[0]]
            self.odd_bits = struct.unpack("<q", struct.pack("<d", value))[0]
            self.events.append((9, odd[0]))
        ramping = self.state in ("FAULT", "STOP") or self.pace > 0.0
        self.clamped = False
        for one, wish in zip(self.commands, wishes, strict=True):
            if not abs(wish) < 1e300:
                self.note(COMMAND_ODD)
                wish = one.last
            if self.state == "INIT" and self.has.safe_start:
                wish = one.safe
            if ramping:
                wish = one.safe + self.gain * (one.last - one.safe)
            elif self.gain < 1.0:
                wish = one.safe + self.gain * (wish - one.safe)
            value = min(max(wish, one.low), one.high)
            value = one.sent = min(max(value, one.sent - one.change), one.sent + one.change)
            if not ramping:
                self.clamped = self.clamped or value != wish
                self.saturated += value != wish
                rises = 0.0 < self.gain < 1.0
                one.last = one.safe + (value - one.safe) / self.gain if rises else value
        if odd:
            self.note(self.has.odd_output)


def crc8(data: bytes) -> int:
    """Return the CRC-8 SAE J1850 of bytes, by long division."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc << 1 ^ (0x11D if crc & 0x80 else 0)
    return crc ^ 0xFF


def crc16(data: bytes) -> int:
    """Return the CRC-16 CCITT-FALSE of bytes, by long division."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = crc << 1 ^ (0x11021 if crc & 0x8000 else 0)
    return crc


@dataclass
class Protection:
    """Where a frame has its counter and CRC; `mask` 0: it has none; `wide`: a CRC of 16 bits."""

    can_id: int
    dlc: int
    every: int
    byte: int = 0
    shift: int = 0
    mask: int = 0
    wide: bool = False
    data_id: int = 0

    def crc(self, data: bytes) -> bytes:
        """Return the CRC over id and data before the last byte; a wide one before the counter."""
        if self.wide:
            rest = data[: self.byte - 2] + data[self.byte : self.dlc]
            return struct.pack("<H", crc16(rest + struct.pack("<H", self.data_id)))
        return bytes([crc8(struct.pack("<H", self.can_id) + data[: self.dlc - 1])])

    @property
    def place(self) -> slice:
        """Where the CRC stands."""
        return slice(self.byte - 2, self.byte) if self.wide else slice(self.dlc - 1, self.dlc)

    def sent(self, data: bytes, counter: int) -> bytes:
        """Return the data with counter and CRC."""
        if not self.mask:
            return data
        out = bytearray(data)
        place = self.mask << self.shift
        out[self.byte] = out[self.byte] & (0xFF ^ place) | (counter & self.mask) << self.shift
        out[self.place] = self.crc(bytes(out))
        return bytes(out)


@dataclass
class ExpectedReceiver:
    """What a receiver makes of the frames of one row."""

    frame: Protection
    last: int = -1
    state: int = 5
    received: int = 0
    lost: int = 0
    repeated: int = 0
    wrong: int = 0
    errors: int = 0
    age: int = 0
    fresh: int = 0
    still: int = 0

    def begin(self) -> None:
        """Begin a cycle."""
        self.age, self.still, self.fresh = self.age + 1, self.still + 1, 0

    def check(self, data: bytes, length: int) -> tuple[int, int]:
        """Return what a frame is, and how many were lost before it."""
        frame, gone = self.frame, 0
        step = 1
        if frame.mask and self.last >= 0:
            step = ((data[frame.byte] >> frame.shift) - self.last) & frame.mask
        if length != frame.dlc or (frame.mask and frame.crc(data) != data[frame.place]):
            self.state, self.errors = 4, self.errors + 1
        elif step == 0:
            self.state, self.repeated = 2, self.repeated + 1
        else:
            if frame.mask:
                gone = step - 1
                if step > 4:
                    gone = min(gone, max(self.still // frame.every - 1, 0))
                self.last, self.still = data[frame.byte] >> frame.shift & frame.mask, 0
                self.lost += gone
            if step > 4:
                self.state, self.wrong = 3, self.wrong + 1
            else:
                self.state, self.received = int(step > 1), self.received + 1
                self.age, self.fresh = 0, 1
        return self.state, gone

    def told(self) -> list[int]:
        """Return its counters in the order of `drivers.can.e2e`."""
        return [self.last, self.state, self.received, self.lost, self.repeated, self.wrong,
                self.errors, self.age, self.fresh, self.still]  # fmt: skip


def packed_data(frame: dbc.Frame, values: Sequence[float]) -> tuple[bytes, int]:
    """Return the data of a frame and how many of its signals are saturated."""
    size = max(frame.dlc, 8)
    word, saturated, layout = [0] * 8 * size, 0, None
    both = [*zip(frame.signals, values, strict=True)]
    for signal, value in (one for one in both if one[0].name == frame.selector):
        layout = 0 if value != value else round(min(max(value, 0.0), 2.0**signal.nbits - 1.0))
    for signal, value in both:
        if signal.layout not in (None, layout):
            continue
        code: Any = (value - signal.offset) / signal.factor
        low, high = signal.codes
        if code == code and not signal.is_float and math.isfinite(code):
            code = round(code)
        bad = code != code or code < low or code > high
        saturated += bad
        code = 0 if code != code else min(max(code, low), high)
        if signal.is_float:
            form = "<f" if signal.nbits == 32 else "<d"
            # a NaN is raw 0, not the number 0: the same bits
            bits = int.from_bytes(struct.pack(form, code), "little")
        else:
            bits = int(code) & ((1 << signal.nbits) - 1)
        at = signal.start
        for i in range(signal.nbits):
            if signal.big_endian:
                word[at] = bits >> (signal.nbits - 1 - i) & 1
                at = at - 1 if at % 8 else at + 15
            else:
                word[at + i] = bits >> i & 1
    parts = (word[8 * b : 8 * b + 8] for b in range(size))
    return bytes(sum(bit << i for i, bit in enumerate(part)) for part in parts), saturated
