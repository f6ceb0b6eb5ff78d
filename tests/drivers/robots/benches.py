"""A robot's drive without a bus: fed with frames, cycle by cycle, beside a mass that it moves."""

import struct
from collections import deque
from collections.abc import Mapping
from typing import Any, ClassVar

import can
import numpy as np
from moteus.protocol import ParsedRegisters, parse_registers

from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.rows import Flag
from pcpc.drivers.compiled.stage import call_at, entry_of
from pcpc.drivers.compiled.structures import structure
from pcpc.drivers.robots import (
    loops,
    mit,
    moteus,
    moteus_registers,
    odrive,
    odrive_settings,
    robstride,
    settings,
)
from pcpc.drivers.robots.fields import FINITE
from pcpc.drivers.robots.layout import Mistake, Robot
from pcpc.drivers.robots.loops import measure

NODE, RATE_HZ = 5, 1000.0
structure(Robot.dtype)


@loop_function
def storm(r: Any, frames: Any, loose: int, seed: int, count: int) -> int:
    """Let a drive hear mutants of `frames` (n, 72), bits of their ids `loose`, and move a load.

    Return how many cycles passed until a number was not finite, all of them if none was.
    """
    draw, q, w, cycles = seed, 0.0, 0.0, 0
    for _ in range(count):
        draw = (draw * 48271) % 2147483647
        which, many = draw // 7 % len(frames), draw // 1024 % 4
        for i in range(72):
            r.rx[i] = frames[which, i]
        for _ in range(many):
            draw = (draw * 48271) % 2147483647
            r.rx[8 + draw // 4096 % max(frames[which, 4], 1)] = draw // 8 & 255
        draw = (draw * 48271) % 2147483647
        if draw & 63 == 0:
            r.rx[4] = draw // 64 % (int(frames[which, 4]) + 1)
        if draw & 64 != 0:
            for i in range(4):
                r.rx[i] ^= draw >> (8 * i) & loose >> (8 * i) & 255
        call_at(r.hears, r)
        if draw & 0x180 == 0:
            r.n_out = 0
            call_at(r.works, r)
            w = min(max(w + r.state.torque / r.rate_hz, -1e3), 1e3)
            q = min(max(q + w / r.rate_hz, -1e3), 1e3)
            measure(r, q, w)
            call_at(r.speaks, r)
            r.k += 1
            cycles += 1
            x = r.state
            fine = abs(x.torque) < FINITE and abs(x.position) < FINITE and abs(x.integral) < FINITE
            if not (fine and abs(x.way_position) < FINITE and abs(x.way_velocity) < FINITE):
                return -cycles
    r.n_out = 0
    return cycles


class Bench:
    """A drive and its load, of inertia 1 in the units of its protocol; `held` keeps it there."""

    kind: ClassVar[tuple[Any, ...]] = (mit, mit.SETTINGS)
    flags = 0  # of the frames that it hears

    def __init__(self, starts: Mapping[str, float] | None = None, drag: float = 0.0) -> None:
        self.dialect, known = self.kind
        self.r: Any = np.zeros(1, Robot.dtype).view(np.recarray)[0]
        self.d = self.r
        every = settings.changed_settings(known, starts or {})
        settings.install(self.r, every)
        kind, hooks = structure(Robot.dtype), (self.dialect.hear, self.dialect.work)
        self.r.hears, self.r.works = (entry_of(one, kind) for one in hooks)
        self.r.speaks = entry_of(self.dialect.speak, kind)
        self.r.position_scale = self.r.velocity_scale = 1.0
        self.d.node, self.d.rate_hz, self.d.rated = NODE, RATE_HZ, 1.0
        self.d.gains = (20.0, 10.0, 5.0)
        self.q = self.w = self.u = 0.0
        self.drag, self.held = drag, False
        self.said: list[tuple[int, int, bytes]] = []
        self.cycles(1)

    def cycles(self, count: int) -> "Bench":
        """Let so many cycles pass."""
        for _ in range(count):
            self.dialect.work(self.r)
            self.u = float(self.x.torque)
            self._collect()
            if not self.held:
                self.w += (self.u - self.drag * self.w) / RATE_HZ
                self.q += self.w / RATE_HZ
            loops.measure(self.r, self.q, self.w)
            self.dialect.speak(self.r)
            self._collect()
            self.d.k += 1
        return self

    def send(self, can_id: int, data: bytes = b"") -> list[bytes]:
        """Let the drive hear a frame; return the data of its answers."""
        before, frame = len(self.said), self.r.rx
        frame[:] = 0
        frame[:4] = list(can_id.to_bytes(4, "little"))
        frame[4], frame[5] = len(data), self.flags
        frame[8 : 8 + len(data)] = list(data)
        self.whose = int(self.dialect.hear(self.r))
        self._collect()
        return [data for _, _, data in self.said[before:]]

    def storm(self, frames: list[tuple[int, bytes]], loose: int, count: int) -> int:
        """Return how many cycles passed while it heard so many mutants of frames; see `storm`."""
        rows = np.zeros((len(frames), 72), np.uint8)
        for row, (word, data) in zip(rows, frames, strict=True):
            row[:4] = list(word.to_bytes(4, "little"))
            row[4], row[5] = len(data), self.flags
            row[8 : 8 + len(data)] = list(data)
        return int(storm(self.r, rows, loose, 20261130, count))

    def mistakes(self) -> dict[str, int]:
        """Return what was counted of the master."""
        return {one.name: int(n) for one, n in zip(Mistake, self.r.mistakes, strict=True) if n}

    @property
    def x(self) -> Any:
        """The drive's state."""
        return self.r.state

    def _collect(self) -> None:
        for i in range(int(self.d.n_out)):
            frame = self.d.outbox[i]
            raw = bytes(frame[8 : 8 + int(frame[4])])
            self.said.append((int(self.d.k), int.from_bytes(bytes(frame[:4]), "little"), raw))
        self.d.n_out = 0


class ODriveBench(Bench):
    """An ODrive; `do` sends a command to it."""

    kind = (odrive, odrive_settings.SETTINGS)

    def do(self, command: int, form: str = "", *values: float) -> list[bytes]:
        """Send a command with its data; return the data of the answers."""
        return self.send(NODE << 5 | command, struct.pack("<" + form, *values))

    def ask(self, command: int) -> bytes:
        """Return the answer to a remote frame."""
        (answer,) = self.send(NODE << 5 | command | 1 << 30, b"")
        return answer

    def closed(self, control: int = 3, mode: int = 1) -> "ODriveBench":
        """Be in CLOSED_LOOP_CONTROL."""
        self.do(0x0B, "II", control, mode)
        self.do(0x07, "I", 8)
        return self


class MoteusBench(Bench):
    """A moteus; `do` sends what the client makes to it."""

    kind = (moteus, moteus_registers.SETTINGS)
    flags = Flag.FD | Flag.BRS

    def do(self, command: Any, source: int = 0) -> ParsedRegisters | None:
        """Send a command of the client; return what it reads of the answer, if there is one."""
        asks = 0x8000 if command.reply_required else 0
        answers = self.send(asks | source << 8 | NODE, bytes(command.data))
        return parse_registers(answers[0]) if answers else None


class RobStrideBench(Bench):
    """A RobStride; `do` sends a frame of a type to it."""

    kind = (robstride, robstride.SETTINGS)
    host = 0xFD

    def do(self, kind: int, data: bytes = bytes(8), extra: int | None = None) -> list[bytes]:
        """Send a frame; return the data of its answers."""
        word = self.host if extra is None else extra
        return self.send(1 << 31 | kind << 24 | word << 8 | NODE, data)

    def on(self, mode: int = 0) -> "RobStrideBench":
        """Be on, in a mode."""
        self.write(0x7005, mode)
        self.do(3)
        return self

    def write(self, number: int, value: float, form: str = "f") -> list[bytes]:
        """Write a setting."""
        form = "I" if isinstance(value, int) else form
        return self.do(0x12, struct.pack("<HH" + form, number, 0, value))

    def read(self, number: int, form: str = "f") -> float:
        """Read a setting."""
        (answer,) = self.do(0x11, struct.pack("<HHI", number, 0, 0))
        assert self.said[-1][1] == 1 << 31 | 0x11 << 24 | NODE << 8 | self.host
        return float(struct.unpack("<HH" + form, answer)[2])


class BenchBus(can.BusABC):
    """A bus of python-can on which a bench answers at once; between frames cycles pass."""

    def __init__(self, bench: Bench, cycles: int = 1) -> None:
        super().__init__(channel="bench")
        self.bench, self.every, self.waiting = bench, cycles, deque[can.Message]()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Let the bench hear a message."""
        before = len(self.bench.said)
        self.bench.send(int(msg.arbitration_id) | msg.is_extended_id << 31, bytes(msg.data))
        self.bench.cycles(self.every)
        for _, word, data in self.bench.said[before:]:
            extended, number = bool(word >> 31), word & 0x1FFFFFFF
            self.waiting.append(
                can.Message(arbitration_id=number, data=data, is_extended_id=extended)
            )

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        assert self.waiting or timeout is not None, "it would wait for ever"
        return (self.waiting.popleft() if self.waiting else None), True
