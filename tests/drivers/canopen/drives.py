"""A drive without a bus: fed with frames, cycle by cycle, beside a mass that it moves."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pcpc.drivers.canopen import layout, objects
from pcpc.drivers.canopen.layout import Od
from pcpc.drivers.canopen.motion import measure
from pcpc.drivers.canopen.node import hear, speak, work
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.structures import structure

NODE, RATE_HZ, SCALE = 5, 1000.0, 1000.0
BUS = np.dtype([("rx", "u1", (16,))])
structure(layout.Canopen.dtype), structure(BUS)


@loop_function
def hear_on(d: Any, bus: Any) -> Any:
    """Let the drive hear what is on a bus: in compiled code frames lie in structures."""
    return hear(d, bus.rx)


@dataclass
class Said:
    """A frame that the drive has sent."""

    cycle: int
    id: int
    data: bytes


@dataclass
class Bench:
    """A drive and its load: a' = push u - drag w; `held` keeps it from moving."""

    push: float = 20.0
    drag: float = 2.0
    held: bool = False
    starts: dict[str, int] = field(default_factory=dict)
    said: list[Said] = field(default_factory=list)

    def __post_init__(self) -> None:
        every = objects.changed_dictionary(objects.objects(NODE, "bench"), self.starts)
        self.objects = every
        self.d: Any = np.zeros(1, layout.Canopen.dtype).view(np.recarray)[0]
        objects.install(self.d, NODE, every)
        self.d.rate_hz, self.d.rated = RATE_HZ, 24.0
        self.d.position_scale = self.d.velocity_scale = SCALE
        self.d.gains = (20.0, 4.0, 10.0)
        self.q = self.w = 0.0
        self.u = 0.0
        self.cycles(1)

    def __getitem__(self, row: int) -> int:
        return int(self.d.value[row])

    def __setitem__(self, row: int, value: int) -> None:
        self.d.value[row] = value

    def cycles(self, count: int) -> "Bench":
        """Let so many cycles pass."""
        for _ in range(count):
            self.u = float(work(self.d))
            self._collect()
            if not self.held:
                self.w += (self.push * self.u - self.drag * self.w) / RATE_HZ
                self.q += self.w / RATE_HZ
            measure(self.d, self.q, self.w)
            speak(self.d)
            self._collect()
            self.d.k += 1
        return self

    def send(self, can_id: int, data: bytes = b"") -> list[Said]:
        """Let the drive hear a frame; return its answers."""
        before, bus = len(self.said), np.zeros(1, BUS).view(np.recarray)[0]
        frame = bus.rx
        frame[:4] = list(can_id.to_bytes(4, "little"))
        frame[4] = len(data)
        frame[8 : 8 + len(data)] = list(data)
        self.whose = int(hear_on(self.d, bus))
        self._collect()
        return self.said[before:]

    def sdo(self, data: bytes) -> bytes:
        """Ask the SDO server; return its answer."""
        (answer,) = self.send(0x600 + NODE, data.ljust(8, b"\0"))
        assert answer.id == 0x580 + NODE
        return answer.data

    def read(self, index: int, subindex: int = 0) -> int:
        """Read an object by SDO; an abort code is negative."""
        answer = self.sdo(bytes([0x40, index & 255, index >> 8, subindex]))
        word = int.from_bytes(answer[4:8], "little")
        return -word if answer[0] == 0x80 else word

    def write(self, index: int, subindex: int, value: int, size: int) -> int:
        """Write an object by SDO; return the abort code, 0 for none."""
        head = bytes([0x23 | (4 - size) << 2, index & 255, index >> 8, subindex])
        answer = self.sdo(head + (value & (1 << 8 * size) - 1).to_bytes(size, "little"))
        assert answer[1:4] == head[1:4]
        return int.from_bytes(answer[4:8], "little") if answer[0] == 0x80 else 0

    def operational(self) -> "Bench":
        """Start the node."""
        self.send(0, bytes([1, 0]))
        return self

    def enabled(self, mode: int) -> "Bench":
        """Be in OPERATION ENABLED in a mode."""
        self[Od.MODE] = mode
        for word in (0x06, 0x07, 0x0F):
            self[Od.CONTROLWORD] = word
            self.cycles(1)
        return self

    def sent(self, can_id: int) -> list[Said]:
        """Return what it has sent with an id."""
        return [one for one in self.said if one.id == can_id]

    def _collect(self) -> None:
        for i in range(int(self.d.n_out)):
            frame = self.d.outbox[i]
            raw = bytes(frame[8 : 8 + int(frame[4])])
            self.said.append(Said(int(self.d.k), int.from_bytes(bytes(frame[:4]), "little"), raw))
        self.d.n_out = 0
