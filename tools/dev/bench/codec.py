"""Packing and unpacking of all frames of the plant's DBC, against cantools and against C.

    Python    drivers.can.codec: pack all frames from one array, unpack all into another
    C         the same tables and results, frame.c at -O2
    cantools  Message.encode and Message.decode, without checks and without names for values

The values are spread evenly over the ranges of the signals. No counters, no CRC: cantools knows of
none. Processor time of the thread for one pass over all frames.
"""

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import dbc
from pcpc.drivers.can.codec import pack, unpack
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.structures import structure
from pcpc.plants.atb1000 import model
from pcpc.tools.dev.bench.compiler import address
from pcpc.tools.dev.bench.frame import library
from pcpc.tools.dev.bench.ratio import Ratio, interleave, processor_time
from pcpc.tools.terminal.progress import Progress

SUITE = "codec"
DBC = model.__file__.replace("model.py", "atb1000.dbc")
PASSES = 5000  # a round
CANTOOLS_PASSES = 10
SEED = 1


@dataclass(frozen=True)
class CodecFrames:
    """All frames of a DBC with values: `table` of can.dbc, `values` and `found` (signals,).

    `record` holds all of it as the loop's own does: arrays on their own are counted references.
    """

    database: dbc.Database
    names: list[str]
    table: dbc.CodecTable
    record: Any

    @property
    def data(self) -> NDArray[np.uint8]:
        """Return the frames' data, (frames, 8)."""
        return self.record["data"]

    @property
    def values(self) -> NDArray[np.float64]:
        """Return what is packed."""
        return self.record["values"]

    @property
    def found(self) -> NDArray[np.float64]:
        """Return what was unpacked."""
        return self.record["found"]

    def messages(self) -> list[tuple[Any, dict[str, float]]]:
        """Return each message of cantools with the values of its signals, 0 for those unused."""
        known = dict(zip(self.table.variables, self.values.tolist(), strict=True))
        messages = [self.database.get_message_by_name(name) for name in self.names]
        return [
            (m, {s.name: known.get(f"{m.name}.{s.name}", 0.0) for s in m.signals}) for m in messages
        ]


def frames_of(path: str = DBC, seed: int = SEED) -> CodecFrames:
    """Return the frames of a DBC with values spread evenly over the signals' ranges; BusError."""
    database = dbc.load(path)
    frames = [dbc.frame(message) for message in database.messages]
    table = dbc.table(frames, 1000.0)
    generator = np.random.default_rng(seed)
    signals = [signal for frame in frames for signal in frame.signals]
    ends = np.array([(s.low, s.high) for s in signals])
    values = ends[:, 0] + generator.random(len(ends)) * (ends[:, 1] - ends[:, 0])
    names = [frame.name for frame in frames]
    kind = np.dtype([
        ("repeats", "<i8"), ("data", "u1", (len(frames), 8)),
        ("frames", table.frames.dtype, table.frames.shape),
        ("signals", table.signals.dtype, table.signals.shape),
        ("values", "<f8", values.shape), ("found", "<f8", values.shape),
    ], align=True)  # fmt: skip
    structure(kind)
    record = np.zeros(1, kind).view(np.recarray)[0]
    record["frames"], record["signals"], record["values"] = table.frames, table.signals, values
    return CodecFrames(database, names, table, record)


@loop_function
def drive(n: Any) -> None:
    """Pack and unpack all frames `repeats` times; `drive_codec` of frame.c does the same."""
    for _ in range(n.repeats):
        for f in range(len(n.frames)):
            pack(n.data[f], f, n.frames, n.signals, n.values)
        for f in range(len(n.frames)):
            unpack(n.data[f], f, n.frames, n.signals, n.found)


def in_python(f: CodecFrames, repeats: int) -> None:
    """Pack and unpack compiled."""
    f.record.repeats = repeats
    drive(f.record)


def in_c(f: CodecFrames, repeats: int, c: ctypes.CDLL) -> None:
    """Pack and unpack in C."""
    arrays = [f.record[name] for name in ("frames", "signals", "data", "values", "found")]
    c.drive_codec(
        ctypes.c_int64(repeats), ctypes.c_int64(len(f.data)), *(address(a) for a in arrays)
    )


def with_cantools(messages: list[tuple[Any, dict[str, float]]]) -> None:
    """Encode and decode once with cantools."""
    for message, values in messages:
        message.decode(message.encode(values, strict=False), decode_choices=False)


def measure(progress: Progress, rounds: int = 15) -> list[Ratio]:
    """Return the ratios to cantools and to C; CompilerError."""
    c, f = library(), frames_of()
    messages = f.messages()

    def cantools_passes() -> None:
        for _ in range(CANTOOLS_PASSES):
            with_cantools(messages)

    sides = (
        processor_time(lambda: in_python(f, PASSES), PASSES),
        processor_time(lambda: in_c(f, PASSES, c), PASSES),
        processor_time(cantools_passes, CANTOOLS_PASSES),
    )
    own, plain, tools = interleave(progress, SUITE, rounds, sides)
    what = f"all {len(f.data)} frames"
    return [
        Ratio.from_rounds(SUITE, what, "cantools", own, tools, "ns"),
        Ratio.from_rounds(SUITE, what, "C -O2, the same tables", own, plain, "ns"),
    ]
