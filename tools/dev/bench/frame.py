"""One CAN frame sent and received by the same process, against C and python-can.

    Python      drivers.can.wire: put_frame, then get_frame, in a compiled loop
    C           the same two functions of frame.c at -O2, on the same sockets and buffers
    python-can  send, then recv, of one can.Bus that receives its own messages

The C is by hand: a device in C has no sockets but those that its main_linux.c opens for itself.
On udp_multicast over loopback, in python-can's format; on vcan0 too where it exists, that is on
machines with that module, or inside `pcpc vm`. Processor time of the thread, kernel included.
"""

import ctypes
import os
import sys
from pathlib import Path
from typing import Any

import can
import numpy as np

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import wire, wire_layout
from pcpc.drivers.can.bus import BusAddress
from pcpc.drivers.can.dbc import SignalKind
from pcpc.drivers.can.wire import END, get_frame, put_frame
from pcpc.drivers.can.wire_layout import Arrival, Medium, Wire
from pcpc.drivers.compiled.jit import i8, loop
from pcpc.drivers.compiled.rows import FrameRow, SignalRow
from pcpc.tools.dev.bench import compiler
from pcpc.tools.dev.bench.compiler import address
from pcpc.tools.dev.bench.ratio import Ratio, interleave, processor_time
from pcpc.tools.machine.jitter.compiler import BenchError
from pcpc.tools.terminal.progress import Progress

SUITE = "frame"
SOURCE = Path(__file__).with_name("frame.c")
AGAINST = "C -O2, the same sockets"
UDP = "udp_multicast:239.74.163.62:43162"  # of its own: no rig's frames are here
VCAN = "vcan0"
CAN_ID = 0x120
FRAMES = 2000  # a round
PYTHON_CAN_FRAMES = 200


def headers() -> dict[str, str]:
    """Return wire.h, what frame.c includes: records, tables and constants of drivers/can."""
    parts = [
        compiler.macros("WIRE", wire_layout),
        compiler.macros("WIRE", wire),
        *map(compiler.numbers, (Medium, Arrival, SignalKind)),
        "#include <stddef.h>\n#include <stdint.h>\n",
        compiler.struct("wire", Wire.dtype),
        compiler.struct("frames", FrameRow.dtype),
        compiler.struct("signals", SignalRow.dtype),
    ]
    return {"wire.h": "".join(parts)}


def library() -> ctypes.CDLL:
    """Return frame.c; CompilerError."""
    return compiler.library([SOURCE], headers())


@loop(i8(END, i8))
def drive(wire: Any, count: Any) -> Any:
    """Send and receive `count` frames; return those received. `drive_frames` does the same in C."""
    received = 0
    for i in range(count):
        wire.tx[8] = i & 255
        put_frame(wire)
        received += get_frame(wire, True) == Arrival.FRAME
    return received


def open_end(bus: BusAddress) -> Any:
    """Return one Wire record (1,) that hears what it sends; BusError.

    A raw CAN socket does not hear itself: on SocketCAN another one sends.
    """
    sender, end = np.recarray(1, Wire.dtype), np.recarray(1, Wire.dtype)
    end.view(np.uint8)[:] = 0
    buses.open_bus(bus, [CAN_ID], end[0])
    if bus.interface == "socketcan":
        buses.open_bus(bus, [], sender[0])
        end[0].fd_tx = sender[0].fd_tx
    end[0].tx[:5] = (CAN_ID & 255, CAN_ID >> 8, 0, 0, 8)
    end[0].tx[8:16] = range(8)
    return end


def open_python_can(bus: BusAddress) -> can.BusABC:
    """Return python-can's bus of this kind that hears itself, on udp_multicast the next port.

    On another port neither side delivers the other's frames. BenchError where it cannot be opened.
    """
    try:
        if bus.interface == "udp_multicast":
            group, port = buses.udp_address(bus.channel)
            return can.Bus(group, "udp_multicast", port=port + 1)  # hears itself in any case
        return can.Bus(bus.channel, bus.interface, receive_own_messages=True)
    except (can.CanError, OSError) as error:
        raise BenchError(
            f"python-can cannot open {bus}: {error}; give loopback a multicast route: "
            "sudo ip route add 224.0.0.0/4 dev lo"
        ) from None


def measure(progress: Progress, rounds: int = 15) -> list[Ratio]:
    """Return the ratios of each bus to C and to python-can; CompilerError, BusError."""
    c, found = library(), []
    names = [UDP]
    if buses.vcan_ready(VCAN):
        names.append(VCAN)
    else:
        progress.close()
        print(
            f"{SUITE}: no {VCAN} here, udp_multicast only; on a kernel with it: "
            "pcpc vm -- python -m pcpc.tools.dev.bench frame",
            file=sys.stderr,
        )
    for name in names:
        bus = buses.bus_named(*buses.parse(name))
        found += measure_on(progress, rounds, bus, c)
    return found


def measure_on(progress: Progress, rounds: int, bus: BusAddress, c: ctypes.CDLL) -> list[Ratio]:
    """Return the ratios on `bus`."""
    end, port = open_end(bus), open_python_can(bus)
    at, count = address(end), ctypes.c_int64(FRAMES)
    message = can.Message(arbitration_id=CAN_ID, is_extended_id=False, data=bytes(range(8)))

    def with_python_can() -> None:
        for _ in range(PYTHON_CAN_FRAMES):
            port.send(message)
            if port.recv(1.0) is None:
                raise BenchError(f"python-can does not hear its own frames on {bus}")

    sides = (
        processor_time(lambda: drive(end[0], FRAMES), FRAMES),
        processor_time(lambda: c.drive_frames(at, count), FRAMES),
        processor_time(with_python_can, PYTHON_CAN_FRAMES),
    )
    try:
        own, plain, theirs = interleave(progress, f"frame on {bus.interface}", rounds, sides)
    finally:
        port.shutdown()
        close_end(end)
    return [
        Ratio.from_rounds(SUITE, bus.interface, AGAINST, own, plain, "ns"),
        Ratio.from_rounds(SUITE, bus.interface, "python-can", own, theirs, "ns"),
    ]


def close_end(end: Any) -> None:
    """Close the sockets of a Wire record (1,)."""
    for descriptor in {int(end[0].fd_tx), int(end[0].fd_rx)}:
        os.close(descriptor)
