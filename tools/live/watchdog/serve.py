"""`pcpc watchdog RIG`: an independent watch, in a process that sees nothing of a run but its bus.

What is wrong (see `watchdog.watch`) is answered by the rig's `supervisor.stop_frame`, again
and again while it lasts, and told. Time in which the watch itself did not run is nobody's silence.

A device of `feed` (/dev/watchdog, a relay that wants a heartbeat) is written while all is well, no
more once the watch has acted, and closed with 'V' at an orderly end.
"""

import os
import select
import signal
import sys
import time
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import choice, wire
from pcpc.drivers.can.wire_layout import FRAME_BYTES, Arrival, Wire
from pcpc.drivers.compiled.jit import i8, loop, types
from pcpc.drivers.compiled.structures import copy
from pcpc.drivers.errors import BusError, Exit
from pcpc.drivers.machine import kernel, realtime
from pcpc.executive.rig.buses import wanted_bus
from pcpc.executive.rig.messages import check_no_drive
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.live.watchdog.commands import WatchdogRequest
from pcpc.tools.live.watchdog.frame_judge import FrameJudge

PRIORITY = 65  # below the nodes, whom it must not delay, above all that is not real-time
_LOOKS = 8  # in the time after which silence is noticed
_TICK_S = 0.001, 0.02
_AT_ONCE = 4096  # frames taken in a look
_FRAMES = types.Array(types.uint8, 2, "C")


@loop(i8(wire.END, _FRAMES))
def _receive(end: Any, frames: Any) -> Any:
    """Take the frames that are there into `frames` (k, 72); return how many, -1: the bus failed."""
    count = np.int64(0)
    for _ in range(frames.shape[0]):
        arrival = wire.get_frame(end, False)
        if arrival == Arrival.FAILED:
            return np.int64(-1)
        if arrival == Arrival.NOTHING:
            break
        if arrival == Arrival.FRAME:
            copy(frames[count], end.rx)
            count += 1
    return count


@loop(i8(wire.END))
def _send(end: Any) -> Any:
    return np.int64(wire.put_frame(end))


class _Bus:
    """The bus of a rig as the watch has it: what came, and the stop frame."""

    def __init__(self, bus: buses.BusAddress, watch: FrameJudge) -> None:
        self.end: Any = np.zeros(1, Wire.dtype).view(np.recarray)[0]
        self.frames = np.zeros((_AT_ONCE, FRAME_BYTES), np.uint8)
        self.end.fd = any(row.frame.fd for row in watch.rows)
        buses.open_bus(bus, [row.frame.can_id for row in watch.rows], self.end)
        buses.set_own_address(self.end)
        self.name, frame = bus, watch.stop_frame
        self.end.tx[:4] = np.frombuffer(frame.word.to_bytes(4, "little"), np.uint8)
        self.end.tx[4:6], self.end.tx[8] = (frame.dlc, frame.flags), 1

    def receive(self) -> NDArray[np.uint8]:
        """Return the frames (k, 72) that have come; BusError."""
        count = _receive(self.end, self.frames)
        if count < 0:
            raise BusError(f"{self.name}: the bus failed: {os.strerror(int(self.end.errno))}")
        return self.frames[:count]

    def stop(self) -> bool:
        """Send the stop frame; return whether the bus took it."""
        return bool(_send(self.end))


class _Feed:
    """A device that wants to be written while all is well; without a path nobody wants it."""

    def __init__(self, path: str | None) -> None:
        self.file = -1
        if path is not None:
            try:
                self.file = os.open(path, os.O_WRONLY | os.O_NONBLOCK)
            except OSError as error:
                cure = "is its driver loaded (modprobe softdog), does somebody read the pipe?"
                raise BusError(f"{path}: cannot be fed: {error.strerror}; {cure}") from None

    def write(self, data: bytes) -> None:
        """Write, if the device takes it; a device that is gone is no reason to stop the rig."""
        if self.file >= 0:
            with suppress(OSError):
                os.write(self.file, data)


def serve(rig: Rig, bus: buses.BusAddress, pacing: str, feed: str | None, ready: int = -1) -> int:
    """FrameJudge until SIGTERM or SIGINT; `ready`, a file, is closed once the bus is heard."""
    watch = FrameJudge(rig, clocked=pacing != "lockstep")
    on_bus, device = _Bus(bus, watch), _Feed(feed or watch.settings.feed)
    signals = {signal.SIGINT, signal.SIGTERM}
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    stop_signals = kernel.signal_file(signals)
    realtime.prepare_thread(PRIORITY, None)
    if ready >= 0:
        os.close(ready)
    else:
        print(f"{rig.config.rig}: watched on {bus}; Ctrl-C ends it", file=sys.stderr, flush=True)
    period_s = 1.0 / rig.config.rate_hz
    tick_s = min(max(watch.settings.silent_cycles * period_s / _LOOKS, _TICK_S[0]), _TICK_S[1])
    looked_s = time.monotonic()
    acted = False
    known: set[str] = set()
    while not select.select([stop_signals], [], [], tick_s)[0]:
        now_s = time.monotonic()
        watch.cycle += min(now_s - looked_s, 2.0 * tick_s) / period_s
        looked_s = now_s
        watch.judge(on_bus.receive())
        troubles = dict(watch.troubles())
        if troubles:
            acted, sent = True, on_bus.stop()
            did = f"{watch.stop_frame.name} sent" if sent else "the bus takes no stop frame"
            at_s = (watch.cycle - watch.begun) * period_s
            for what in troubles.keys() - known:
                said = f"{at_s:.3f} s: watchdog: {troubles[what]}; {did}"
                print(said, file=sys.stderr, flush=True)
        elif not acted:
            device.write(b"\0")
        known = set(troubles)
    if not acted:
        device.write(b"V")
    return Exit.SAFETY_STOP if acted else Exit.OK


def command(request: WatchdogRequest) -> int:
    """FrameJudge the runs of a rig from outside of them, until Ctrl-C."""
    rig = load_rig(request.rig, request.controller, request.set)
    check_no_drive(rig, "the watchdog does not know the frames of a drive")
    wanted = replace(wanted_bus(rig, (), request.bus), roles=("watchdog",), count=1)
    held = choice.take_bus(wanted)
    return serve(rig, held.bus, request.pacing or rig.config.pacing, request.feed)
