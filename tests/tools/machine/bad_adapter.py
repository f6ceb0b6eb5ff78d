"""An emulated adapter that is not what it should be, by number of the frames that it carries.

    python bad_adapter.py FAULT PERIOD PORT PORT

carries datagrams between two ports of GROUP, and does every PERIOD-th wrongly, until it is ended.
`BadEnd` does the same at an end inside of this process, and gives hardware stamps, too.
"""

import heapq
import itertools
import random
import select
import socket
import sys
import time
from collections.abc import Iterator

from pcpc.drivers.can import bus as buses
from pcpc.tools.machine.doctor.adapter.ends import HeardFrame, Origin, UdpEnd

GROUP = "239.74.163.77"
FAULTS = "loss", "twice", "order", "delay", "bit", "length"
DELAY_S = 0.02


class BadEnd(UdpEnd):
    """An end that hears every `period`-th frame wrongly; "" for a good one."""

    def __init__(self, channel: str, fault: str, period: int, seed: int = 1) -> None:
        super().__init__(channel)
        self.fault, self.period, self.count = fault, period, 0
        self.kept: HeardFrame | None = None
        self.draw = random.Random(seed)
        self.offset_ns = 12_345

    def _is_hit(self) -> bool:
        self.count += 1
        return self.draw.random() * self.period < 1.0

    def frames(self) -> Iterator[HeardFrame]:  # type: ignore[override]
        for one in super().frames():
            if one.stamp_ns is None or one.origin is not Origin.OTHER:
                yield one
                continue
            stamp_ns = one.stamp_ns
            hit = self._is_hit()
            own_ns = stamp_ns - 10**18 + self.offset_ns
            if self.fault == "stamps jump" and hit:
                self.offset_ns += 3_000_000
            if self.fault == "stamps run fast":
                own_ns = int(own_ns * 1.002)
            if self.fault == "stamps go back" and hit:
                own_ns -= 40_000_000
            if self.fault == "stamps stand still":
                own_ns = 7
            if self.fault == "kernel stamps late" and hit:
                one = one._replace(stamp_ns=stamp_ns + 500_000_000)
            one = one._replace(hardware_ns=own_ns)
            if self.fault == "loss" and hit:
                continue
            if self.fault == "order" and hit and self.kept is None:
                self.kept = one
                continue
            if self.fault == "delay" and hit:
                one = one._replace(
                    stamp_ns=one.read_ns + 20_000_000, read_ns=one.read_ns + 20_000_001
                )
            if self.fault == "bit" and hit:
                at = self.draw.randrange(8 * len(one.data))
                data = int.from_bytes(one.data, "little") ^ 1 << at
                one = one._replace(data=data.to_bytes(len(one.data), "little"))
            if self.fault == "length" and hit:
                one = one._replace(data=one.data[:-1])
            if self.fault == "id" and hit:
                one = one._replace(word=one.word ^ 0x40)
            yield one
            if self.fault == "twice" and hit:
                yield one
            if self.kept is not None:
                yield self.kept
                self.kept = None


def _ends(port: int) -> tuple[socket.socket, socket.socket]:
    out, into = buses._open_udp(f"{GROUP}:{port}")
    return socket.socket(fileno=out), socket.socket(fileno=into)


def carry(fault: str, period: int, ports: tuple[int, int]) -> None:
    """Carry both ways for ever; stdout says that it began."""
    sides = [_ends(port) for port in ports]
    own = [out.getsockname() for out, _ in sides]
    later: list[tuple[float, int, int, bytes]] = []
    draw, number = random.Random(5), itertools.count()
    kept: dict[int, bytes] = {}
    print("carries", flush=True)
    while True:
        timeout_s = max(later[0][0] - time.monotonic(), 0.0) if later else 1.0
        ready, _, _ = select.select([into for _, into in sides], (), (), timeout_s)
        while later and later[0][0] <= time.monotonic():
            _, _, to, text = heapq.heappop(later)
            sides[to][0].send(text)
        for side, (_, into) in enumerate(sides):
            if into not in ready:
                continue
            text, sender = into.recvfrom(2048)
            if sender in own:
                continue
            hit, to = draw.random() * period < 1.0, 1 - side
            if hit and fault == "bit":
                at = text.index(b"data") + 8
                text = text[:at] + bytes([text[at] ^ 4]) + text[at + 1 :]
            if hit and fault == "loss":
                continue
            if hit and fault == "order" and to not in kept:
                kept[to] = text
                continue
            if hit and fault == "delay":
                heapq.heappush(later, (time.monotonic() + DELAY_S, next(number), to, text))
                continue
            for _ in range(2 if hit and fault == "twice" else 1):
                sides[to][0].send(text)
            if to in kept:
                sides[to][0].send(kept.pop(to))


if __name__ == "__main__":
    carry(sys.argv[1], int(sys.argv[2]), (int(sys.argv[3]), int(sys.argv[4])))
