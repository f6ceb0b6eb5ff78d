"""One cycle of the executive against a device in C, with the frames of a run of slew10.

    in memory   3 feedback frames (and the slow ones when due) from an inbox: CRC and counter,
                decoding; supervisor; tunings; quintic reference and pd step; limit; encoding,
                protection, sending of CMD and SYNC (and slow frames) into an outbox; timing,
                seqlock snapshot of all variables; one record row, one row a frame. No system call.
    on the bus  the same over udp_multicast sockets on loopback, with clock_nanosleep to a deadline
                half a period ago, clock readings, recv until nothing is there (the node hears
                its own frames too, as in any run) and send.
    publish     the seqlock snapshot of 256 variables against a plain memcpy of 2048 bytes

Python is `executive.loop.cycle.one_pass` as the real loop compiles it, C is what `pcpc generate c
slew10 --device` writes, at -O2: it sends the same frames. It is no equal in work: it keeps no
records, timing or snapshot, and forms each CRC bit by bit, for small memories. A cycle in C by
hand, with all that and with tables, took 0.67 of the device's time in memory. Publishing
and sockets stay by hand (frame.c): a device has no snapshot, and its sockets are its own. In
memory: processor time over whole recordings; on the bus: median over passes, each timed from before
its sleep to its end.
"""

import ctypes
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import wire
from pcpc.drivers.can.wire import put_frame
from pcpc.drivers.can.wire_layout import QUEUE_FRAMES, Wire
from pcpc.drivers.compiled.jit import i8, loop, types, u1
from pcpc.drivers.compiled.structures import copy
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import Time, Trigger, now
from pcpc.executive.loop.cycle import STEPS, N, one_pass
from pcpc.executive.loop.ring_layout import OfFrame
from pcpc.executive.loop.rings import publish_table
from pcpc.executive.nodes.install import install_in_memory
from pcpc.executive.nodes.plan import Plan, plan
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.atb1000 import model
from pcpc.tools.dev.bench import compiler, frame
from pcpc.tools.dev.bench.compiler import address
from pcpc.tools.dev.bench.ratio import Measurement, Ratio, interleave, processor_time
from pcpc.tools.make.generate.device import device
from pcpc.tools.terminal.progress import Progress

SUITE = "cycle"
AGAINST = "C -O2, a device"
RIG = model.__file__.replace("model.py", "rigs/slew10.yaml")
SOURCE = Path(__file__).with_name("device_cycle.c")
_OWN_MAIN = ("main_linux.c", "main_mps2.c", "run.c", "slcan.c", "startup.c", "soft_double.c")
BUS = "udp_multicast:239.74.163.61:43161"  # of its own: no rig's frames are here
FIRST, CYCLES = 500, 1600  # the move up; a whole number of turns of every counter
REPEATS = 40  # of the recording, in a round in memory: the call itself takes 1 ms
PUBLISHED = 256
PUBLICATIONS = 20_000


def library() -> ctypes.CDLL:
    """Return the device of slew10 with its drivers and frame.c; CompilerError, RigError."""
    texts = {name: text for name, text in device(load_rig(RIG)).items() if name not in _OWN_MAIN}
    return compiler.library([SOURCE, frame.SOURCE], texts | frame.headers())


@dataclass(frozen=True)
class ReceivedFrames:
    """The frames that a node receives in each of CYCLES cycles from FIRST on.

    `frames` (n, 16) as struct can_frame; `ends` (cycles,) where each cycle's end.
    """

    plan: Plan
    frames: NDArray[np.uint8]
    ends: NDArray[np.int64]


def record(first: int = FIRST, cycles: int = CYCLES) -> ReceivedFrames:
    """Return the frames of the executive in a virtual run of slew10."""
    rig = load_rig(RIG, settings=[f"duration_s={(first + cycles + 10) / 1000.0}"])
    run = VirtualRun(rig, None)
    for _ in run.advance():
        pass
    block = run.blocks[0]
    rows = block["frame"][: int(block.ends("frame").head)]
    about, cycle = rows[:, OfFrame.ABOUT], rows[:, OfFrame.CYCLE]
    chosen = rows[(about >> 40 & 1 == 1) & (cycle >= first) & (cycle < first + cycles)]
    words = np.zeros((len(chosen), 2), np.int64)  # id and flags, length; data
    words[:, 0] = chosen[:, OfFrame.ABOUT] & 0xFF_FFFF_FFFF
    words[:, 1] = chosen[:, OfFrame.PAYLOAD]
    ends = np.searchsorted(chosen[:, OfFrame.CYCLE], np.arange(first, first + cycles), "right")
    return ReceivedFrames(plan(rig, "executive", "lockstep"), words.view(np.uint8), ends)


def new_loop(made: Plan) -> Any:
    """Return a LOOP record of its own for `made`, without bus and clock."""
    memory = np.recarray(1, sh.LOOP)
    memory.view(np.uint8)[:] = 0
    install_in_memory(made, memory[0])
    memory[0].guard.cycles = 2**62
    return memory[0]


@loop(types.void(N))
def _put_back(n: Any) -> None:
    """Empty the rings, as a recorder would."""
    n.record_taken[0] = n.record_ends.head
    n.frame_taken[0] = n.frame_ends.head
    n.event_taken[0] = n.event_ends.head


@loop(types.void(N, STEPS, u1[:, ::1], i8[::1], i8))
def drive_memory(n: Any, steps: Any, frames: Any, ends: Any, repeats: Any) -> None:
    """Run through the recorded cycles `repeats` times; as in device_cycle.c."""
    for _ in range(repeats):
        first = 0
        _put_back(n)
        for k in range(ends.shape[0]):
            for i in range(first, ends[k]):
                copy(n.wire.inbox[n.wire.inbox_put % QUEUE_FRAMES], frames[i])
                n.wire.inbox_put += 1
            first = ends[k]
            n.clock.now_ns = n.k * n.clock.period_ns
            n.wire.outbox_put = 0
            one_pass(n, steps)


@loop(types.void(N, STEPS, wire.END, u1[:, ::1], i8[::1], i8, i8[::1]))
def drive_bus(
    n: Any, steps: Any, peer: Any, frames: Any, ends: Any, cycles: Any, took: Any
) -> None:
    """As `drive_memory` over `peer`'s bus; `took[k]` is the time of pass k, ns."""
    first = 0
    _put_back(n)
    for k in range(cycles):
        for i in range(first, ends[k]):
            copy(peer.tx, frames[i])
            put_frame(peer)
        first = ends[k]
        began = now(n.clock)
        n.clock.deadline = began - n.clock.period_ns // 2
        one_pass(n, steps)
        took[k] = now(n.clock) - began


@loop(types.void(N, i8))
def drive_publish(n: Any, repeats: Any) -> None:
    """Publish the table `repeats` times."""
    for _ in range(repeats):
        publish_table(n)


def measure(progress: Progress, rounds: int = 15) -> list[Ratio]:
    """Return the ratios "in memory", "on the bus" and "publish"; CompilerError, BusError."""
    c = library()
    progress.show("recording the frames: a virtual run")
    recording = record()
    cases = {
        "in memory": (AGAINST, _memory(recording, c)),
        "on the bus": (AGAINST, _bus(recording, c)),
        "publish 256": ("memcpy of 2048 bytes", _publish(recording, c)),
    }
    found = []
    for what, (against, sides) in cases.items():
        times = interleave(progress, f"cycle {what}", rounds, sides)
        found.append(Ratio.from_rounds(SUITE, what, against, times[0], times[1], "ns"))
    return found


def begin(c: ctypes.CDLL, wire: Any = None) -> None:
    """Put the device, of which a program has one, to its start: in memory or on a bus."""
    assert c.begin(None if wire is None else address(wire)), "compiled to other bits"


def _memory(recording: ReceivedFrames, c: ctypes.CDLL) -> tuple[Measurement, ...]:
    made, frames, ends = recording.plan, recording.frames, recording.ends
    n = new_loop(made)
    arrays = address(frames), address(ends), ctypes.c_int64(len(ends)), ctypes.c_int64(REPEATS)
    count = REPEATS * len(ends)
    timed = processor_time(lambda: c.drive_memory(*arrays), count)

    def in_c() -> float:
        begin(c)
        return timed()

    return (
        processor_time(lambda: drive_memory(n, made.steps, frames, ends, REPEATS), count),
        in_c,
    )


def _bus(recording: ReceivedFrames, c: ctypes.CDLL) -> tuple[Measurement, ...]:
    made, frames, ends = recording.plan, recording.frames, recording.ends
    n = new_loop(made)
    peer = np.recarray(1, Wire.dtype)
    peer.view(np.uint8)[:] = 0
    bus = buses.bus_named(*buses.parse(BUS))
    buses.open_bus(bus, made.receive_ids, n.wire)
    buses.open_bus(bus, [], peer[0])
    buses.set_own_address(n.wire)
    os.close(int(peer[0].fd_rx))  # it only sends
    n.clock.kind, n.clock.trigger = Time.LOCKSTEP, Trigger.CLOCKED
    n.clock.late_ns = n.clock.period_ns  # half a period is on time: no sleep of 50 us until now
    took = np.zeros(len(ends), np.int64)
    numbers = ctypes.c_int64(len(ends)), ctypes.c_int64(int(n.clock.period_ns))
    arrays = address(peer), address(frames), address(ends), *numbers, address(took)

    def python() -> float:
        drive_bus(n, made.steps, peer[0], frames, ends, len(ends), took)
        return float(np.median(took))

    def in_c() -> float:
        begin(c, n.wire)
        c.drive_bus(*arrays)
        return float(np.median(took))

    return python, in_c


def _publish(recording: ReceivedFrames, c: ctypes.CDLL) -> tuple[Measurement, ...]:
    n = new_loop(recording.plan)
    n.n_variables = PUBLISHED
    to, values = address(n.snapshot), address(n.v)
    numbers = ctypes.c_int64(8 * PUBLISHED), ctypes.c_int64(PUBLICATIONS)
    return (
        processor_time(lambda: drive_publish(n, PUBLICATIONS), PUBLICATIONS),
        processor_time(lambda: c.drive_copy(to, values, *numbers), PUBLICATIONS),
    )
