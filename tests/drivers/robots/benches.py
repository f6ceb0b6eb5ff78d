"""A robot's drive without a bus: fed with frames, cycle by cycle, beside a mass that it moves."""

import struct
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from moteus.protocol import ParsedRegisters, parse_registers

from pcpc.drivers.compiled.rows import Flag
from pcpc.drivers.compiled.structures import structure
from pcpc.drivers.robots import (
    loops,
    mit,
    moteus,
    moteus_registers,
    odrive,
    odrive_settings,
    settings,
)
from pcpc.drivers.robots.layout import Mistake, Robot

NODE, RATE_HZ = 5, 1000.0
structure(Robot.dtype)


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
