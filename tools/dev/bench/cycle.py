"""One cycle of the executive against the same cycle in C, with the frames of a run of slew10.

    in memory   3 feedback frames (and the slow ones when due) from an inbox: CRC and counter,
                decoding; supervisor; tunings; quintic reference and pd step; limit; encoding,
                protection, sending of CMD and SYNC (and slow frames) into an outbox; timing,
                seqlock snapshot of all variables; one record row, one row a frame. No system call.
    on the bus  the same over udp_multicast sockets on loopback, with clock_nanosleep to a deadline
                half a period ago, clock readings, recv until nothing is there (the node hears
                its own frames too, as in any run) and send.
    publish     the seqlock snapshot of 256 variables against a plain memcpy of 2048 bytes

Python is `executive.loop.cycle.one_pass` as the real loop compiles it, C is cycle.c and frame.c at
-O2: the same algorithm on the same LOOP record, table driven as here, with the same results bit for
bit; where C has a shorter word for it (memcpy, an 8-byte load) it uses it. Both work in turn on one
record, so that memory and its place in the caches are equal. In memory: processor time over whole
recordings; on the bus: median over passes, each timed from before its sleep to its end.
"""

import ctypes
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import e2e, wire, wire_layout
from pcpc.drivers.can.dbc import Kind, Protection
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.can.wire import put_frame
from pcpc.drivers.can.wire_layout import QUEUE_FRAMES, WIRE, Arrival, Medium
from pcpc.drivers.canopen import layout as canopen
from pcpc.drivers.compiled.jit import i8, loop, types, u1
from pcpc.drivers.compiled.structures import copy
from pcpc.executive.laws import references
from pcpc.executive.laws.block import Block
from pcpc.executive.laws.idle import idle
from pcpc.executive.loop import (
    faults,
    meeting,
    reception,
    states,
    strangers,
    timing,
    variables,
)
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import Time, Trigger, now
from pcpc.executive.loop.cycle import STEPS, N, one_pass
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.requests import Refusal
from pcpc.executive.loop.ring_layout import OfFrame, OfRecord
from pcpc.executive.loop.rings import publish_table
from pcpc.executive.loop.sending import LastWord
from pcpc.executive.loop.supervisor import Overrun
from pcpc.executive.loop.timing_layout import USAGE, Stage
from pcpc.executive.nodes.install import install_in_memory
from pcpc.executive.nodes.plan import Plan, plan
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.atb1000 import model
from pcpc.plants.atb1000.laws import pd
from pcpc.tools.dev.bench import compiler
from pcpc.tools.dev.bench.compiler import address
from pcpc.tools.dev.bench.ratio import Measurement, Ratio, interleave, processor_time
from pcpc.tools.terminal.progress import Progress

SUITE = "cycle"
AGAINST = "C -O2, the same cycle"
RIG = model.__file__.replace("model.py", "rigs/slew10.yaml")
SOURCE, FRAME = (Path(__file__).with_name(name) for name in ("cycle.c", "frame.c"))
BUS = "udp_multicast:239.74.163.61:43161"  # of its own: no rig's frames are here
FIRST, CYCLES = 500, 1600  # the move up; a whole number of turns of every counter
REPEATS = 40  # of the recording, in a round in memory: the call itself takes 1 ms
PUBLISHED = 256
PUBLICATIONS = 20_000
_MODULES = {
    "SH": sh, "V": variables, "E2E": e2e, "WIRE": wire_layout, "TIMING": timing,
    "STRANGERS": strangers, "RECEPTION": reception, "CANOPEN": canopen,
}  # fmt: skip
NUMBERED = (
    FrameState, states.State, states.Condition, faults.Fault, Event, Time, Trigger, Refusal,
    Overrun, LastWord, Medium, Arrival, Protection, Kind, meeting.Part, meeting.Turn,
    canopen.Power, Stage, OfRecord, OfFrame,
)  # fmt: skip
BLOCKS = {"quintic": references.quintic, "pd": pd.BLOCK, "barrel": model.BLOCK, "idle": Block(idle)}


def library() -> ctypes.CDLL:
    """Return cycle.c, frame.c and generated steps with the functions of emath.py; CompilerError."""
    headers = {"loop.h": loop_header(), FRAME.name: FRAME.read_text(encoding="utf-8")}
    return compiler.library([SOURCE], BLOCKS, headers)


def loop_header() -> str:
    """Return loop.h: the LOOP record as a struct, constants and tables of the loop's modules."""
    record = _without_drive()
    fields: Any = record.fields
    texts = [compiler.macros(prefix, module) for prefix, module in _MODULES.items()]
    texts += [
        compiler.macros("WIRE", wire),
        *map(compiler.numbers, NUMBERED),
        "#include <stddef.h>\n#include <stdint.h>\n",
        *(compiler.struct(name, kind) for name, kind in _rows(record).items()),
        *(compiler.struct(name, kind) for name, (kind, *_) in fields.items() if kind.fields),
        compiler.struct("loop", record),
        compiler.array("CRC_TABLE", "uint8_t", e2e._CRC_TABLE),
        compiler.array("CRC_16_TABLE", "uint16_t", e2e._CRC_16_TABLE),
        compiler.array("NEXT", "int64_t", states.NEXT),
        compiler.array("NMT", "double", states.HEARTBEATS),
        compiler.array("POWER_WORDS", "int64_t", canopen.POWER_WORDS),
        compiler.array("ERROR_CODES", "double", faults.ERROR_CODES),
        compiler.array("ERROR_REGISTERS", "double", faults.ERROR_REGISTERS),
        compiler.array("USAGE", "int64_t", np.array([*USAGE.values()])),
        compiler.array("COUNTERS", "int64_t", timing.COUNTER_WORDS),
    ]
    return "".join(texts)


def _without_drive() -> np.dtype[Any]:
    """Return LOOP, with plain bytes in the place of drives, which no cycle here has."""
    fields: Any = dict(sh.LOOP.fields or {})
    for one in ("canopen", "robot"):
        kind, place, *_ = fields[one]
        fields[one] = np.dtype(("u1", (kind.itemsize,))), place
    return np.dtype({
        "names": list(fields), "formats": [one[0] for one in fields.values()],
        "offsets": [one[1] for one in fields.values()], "itemsize": sh.LOOP.itemsize,
    })  # fmt: skip


def _rows(kind: Any) -> dict[str, np.dtype[Any]]:
    """Return the types of rows in a record and in its parts, by the name of the table."""
    found: dict[str, np.dtype[Any]] = {}
    for name, (table, *_) in kind.fields.items():
        found |= _rows(table) if table.fields else {}
        if table.base.fields and (table.shape or "canopen" not in kind.fields):
            found[name] = table.base
    return found


@dataclass(frozen=True)
class Recording:
    """The frames that a node receives in each of CYCLES cycles from FIRST on.

    `frames` (n, 16) as struct can_frame; `ends` (cycles,) where each cycle's end.
    """

    plan: Plan
    frames: NDArray[np.uint8]
    ends: NDArray[np.int64]


def record(first: int = FIRST, cycles: int = CYCLES) -> Recording:
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
    return Recording(plan(rig, "executive", "lockstep"), words.view(np.uint8), ends)


def new_loop(made: Plan) -> Any:
    """Return a LOOP record of its own for `made`, without bus and clock."""
    memory = np.recarray(1, sh.LOOP)
    memory.view(np.uint8)[:] = 0
    install_in_memory(made, memory[0])
    memory[0].guard.cycles = 2**62
    return memory[0]


def in_c(entries: Sequence[int], library: ctypes.CDLL) -> Any:
    """Return the table of C functions for the compiled steps of a plan."""
    names = {block.step.entry: name for name, block in BLOCKS.items()}
    functions = [getattr(library, names[entry]) for entry in entries]
    pointers = [ctypes.cast(function, ctypes.c_void_p).value for function in functions]
    return (ctypes.c_void_p * len(pointers))(*pointers)


@loop(types.void(N))
def _put_back(n: Any) -> None:
    """Empty the rings, as a recorder would."""
    n.record_taken[0] = n.record_ends.head
    n.frame_taken[0] = n.frame_ends.head
    n.event_taken[0] = n.event_ends.head


@loop(types.void(N, STEPS, u1[:, ::1], i8[::1], i8))
def drive_memory(n: Any, steps: Any, frames: Any, ends: Any, repeats: Any) -> None:
    """Run through the recorded cycles `repeats` times; `drive_memory` of cycle.c does the same."""
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


def _memory(recording: Recording, c: ctypes.CDLL) -> tuple[Measurement, ...]:
    made, frames, ends = recording.plan, recording.frames, recording.ends
    n = new_loop(made)
    at, table, repeats = address(n[0]), in_c(made.steps, c), ctypes.c_int64(REPEATS)
    arrays = address(frames), address(ends), ctypes.c_int64(len(ends))
    count = REPEATS * len(ends)
    return (
        processor_time(lambda: drive_memory(n, made.steps, frames, ends, REPEATS), count),
        processor_time(lambda: c.drive_memory(at, table, *arrays, repeats), count),
    )


def _bus(recording: Recording, c: ctypes.CDLL) -> tuple[Measurement, ...]:
    made, frames, ends = recording.plan, recording.frames, recording.ends
    n = new_loop(made)
    peer = np.recarray(1, WIRE)
    peer.view(np.uint8)[:] = 0
    bus = buses.bus_named(*buses.parse(BUS))
    buses.open_bus(bus, made.receive_ids, n.wire)
    buses.open_bus(bus, [], peer[0])
    buses.set_own_address(n.wire)
    os.close(int(peer[0].fd_rx))  # it only sends
    n.clock.kind, n.clock.trigger = Time.LOCKSTEP, Trigger.CLOCKED
    n.clock.late_ns = n.clock.period_ns  # half a period is on time: no sleep of 50 us until now
    took = np.zeros(len(ends), np.int64)
    at, other, table = address(n[0]), address(peer), in_c(made.steps, c)
    cycles = ctypes.c_int64(len(ends))

    def python() -> float:
        drive_bus(n, made.steps, peer[0], frames, ends, len(ends), took)
        return float(np.median(took))

    def in_plain_c() -> float:
        c.drive_bus(at, table, other, address(frames), address(ends), cycles, address(took))
        return float(np.median(took))

    return python, in_plain_c


def _publish(recording: Recording, c: ctypes.CDLL) -> tuple[Measurement, ...]:
    n = new_loop(recording.plan)
    n.n_variables = PUBLISHED
    at = address(n[0])
    return (
        processor_time(lambda: drive_publish(n, PUBLICATIONS), PUBLICATIONS),
        processor_time(lambda: c.drive_copy(at, ctypes.c_int64(PUBLICATIONS)), PUBLICATIONS),
    )
