"""When a device's frames were on the bus, by the kernel's clock.

A plant that wakes by itself stamps a frame when its cycle takes it. A process of its own hears the
same bus and keeps of it, however long the run is,

    jitter     |SYNC - the SYNC before - period|                                            (1)
    reaction   the first command after a frame of the plant - that frame                    (2)

each as a count by whole microseconds.
"""

import contextlib
import json
import signal
import socket
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path

import msgpack

from pcpc.drivers.can.bus import BusAddress, listener
from pcpc.drivers.can.can_id import word_of
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig
from pcpc.tools.make.device.below import NodesBelow
from pcpc.tools.start.children import Child

FILE = "arrivals.json"  # in the run's folder, until the device is judged
FIRST = 2  # the SYNC from which on a device has to keep time: two begin the plant's cycles
_FRAME, _TIME = struct.Struct("=I"), struct.Struct("=qq")
_DATAGRAM_BYTES, _ANCILLARY_BYTES = 512, 64
Counts = dict[str, Counter[int]]


class Arrivals:
    """Counts of (1) and (2), us; `sync`, `commands`, `plant` are the words of ids."""

    def __init__(
        self, sync: int, commands: Collection[int], plant: Collection[int], period_ns: int
    ) -> None:
        self.sync, self.commands, self.plant = sync, frozenset(commands), frozenset(plant)
        self.period_ns = period_ns
        self.counts: Counts = {"jitter": Counter(), "reaction": Counter()}
        self._syncs, self._last_ns, self._asked_ns = 0, 0, -1

    @classmethod
    def of(cls, rig: Rig) -> "Arrivals":
        """Return what is to be heard in runs of a rig; BusError if its DBC file is not there."""
        below = NodesBelow(rig)
        heard, sent = ([frame for _, frame in of] for of in (below.heard, below.told))
        sync = next(frame.word for frame in heard if frame.has_sequence)
        commands = [one.word for one in heard if messages.is_awaited(one) and one.word != sync]
        period_ns = rig.config.period_ns
        return cls(
            sync, commands, [one.word for one in sent if messages.is_awaited(one)], period_ns
        )

    def came(self, word: int, stamp_ns: int) -> None:
        """Take a frame."""
        if word == self.sync:
            if self._syncs >= FIRST:
                off_ns = abs(stamp_ns - self._last_ns - self.period_ns)
                self.counts["jitter"][off_ns // 1000] += 1
            self._syncs, self._last_ns = self._syncs + 1, stamp_ns
        elif word in self.plant:
            self._asked_ns = stamp_ns
        elif word in self.commands and self._asked_ns >= 0:
            self.counts["reaction"][(stamp_ns - self._asked_ns) // 1000] += 1
            self._asked_ns = -1


def share(counts: Counter[int], percent: float) -> float:
    """Return the value below which `percent` of the counted ones are; ValueError without any."""
    if not counts:
        raise ValueError("nothing was counted")
    left = percent / 100.0 * (counts.total() - 1)
    for value in sorted(counts):
        left -= counts[value]
        if left < 0.0:
            break
    return float(value)


def start_witness(rig: Rig, bus: BusAddress, folder: Path) -> Child:
    """Start to listen; it writes FILE into `folder` when it is asked to end. BusError."""
    heard, ear = Arrivals.of(rig), listener(bus)

    def main(_: Sequence[str]) -> int:
        stopped: list[int] = []
        signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for word, stamp_ns in _frames(ear, bus, lambda: bool(stopped)):
            heard.came(word, stamp_ns)
        (folder / FILE).write_text(json.dumps(heard.counts))
        return 0

    with ear:
        return Child.fork("witness", main, ())


def read_counts(folder: Path) -> Counts:
    """Return what was counted, and remove the file; nothing where there is none."""
    file, counts = folder / FILE, Counts()
    with contextlib.suppress(OSError, ValueError):
        told = json.loads(file.read_text())
        counts = {name: Counter({int(us): n for us, n in of.items()}) for name, of in told.items()}
    with contextlib.suppress(OSError):
        file.unlink()
    return counts


def _frames(
    ear: socket.socket, bus: BusAddress, stopped: Callable[[], bool]
) -> Iterator[tuple[int, int]]:
    """Yield the word and the time, ns, of each frame, until there is none and it is to end."""
    word_in = _word_of_frame if bus.interface == "socketcan" else _word_of_datagram
    while True:
        try:
            data, ancillary, _, _ = ear.recvmsg(_DATAGRAM_BYTES, _ANCILLARY_BYTES)
        except BlockingIOError:  # nothing came for 20 ms
            if stopped():
                return
            continue
        except OSError:
            return
        stamps = [told for level, kind, told in ancillary if level == socket.SOL_SOCKET]
        word = word_in(data)
        if word is not None and stamps:
            seconds, rest_ns = _TIME.unpack(stamps[0])
            yield word, 1_000_000_000 * seconds + rest_ns


def _word_of_frame(data: bytes) -> int | None:
    return _FRAME.unpack_from(data)[0] if len(data) >= _FRAME.size else None


def _word_of_datagram(data: bytes) -> int | None:
    """Return the word of python-can's datagram; None if it is none."""
    try:
        told = msgpack.unpackb(data)
        return word_of(told["arbitration_id"], told["is_extended_id"])
    except (ValueError, TypeError, KeyError, msgpack.UnpackException):
        return None
