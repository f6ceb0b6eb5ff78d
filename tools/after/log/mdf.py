"""An ASAM MDF 4 file of a log, written with asammdf.

    variables    a channel each, float64, with unit and meaning; before them `time_ns` and `cycle`
    frames       ASAM's bus logging, bus channel 1: CAN_DataFrame, CAN_RemoteFrame
    events       a marker each, in words; its comment is the log's entry as JSON, with its topic

Times are s since the log's t = 0, float64; those of markers whole ns. The header has its wall time
and, since the format has no checksums, that of the data frames.
"""

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.can.wire_layout import LENGTHS, Flag
from pcpc.tools.after.log.info import entry_text

Column = tuple[str, str, str, NDArray[Any]]  # name, unit, help, values
Entry = tuple[int, str, Mapping[str, Any]]  # wall time in ns, topic, what the log has
_BUS_CHANNEL = 1
_SECONDS, _MARKER = 1, 6  # of asammdf
_SUMMED = ("stamp_ns", "id", "dlc", "direction", "flags")  # of a frame, before its data


def frames_sum(frames: NDArray[Any], wall_ns: NDArray[np.int64]) -> str:
    """Return number and checksum of data frames (n,), by their wall times (n,).

    What lies in `data` behind a frame's length is none of it.
    """
    rows = np.zeros(len(frames), [*((name, "<i8") for name in _SUMMED), ("data", "u1", (64,))])
    for name in _SUMMED:
        rows[name] = frames[name] if name != "stamp_ns" else wall_ns
    width = frames["data"].shape[1]
    rows["data"][:, :width] = frames["data"] * (np.arange(width) < frames["dlc"][:, None])
    return f"{len(rows)} data frames, CRC-32 {zlib.crc32(rows.tobytes()):08X}"


@dataclass(frozen=True)
class Content:
    """What a file holds; all by time."""

    zero_ns: int  # wall time of t = 0
    table: Sequence[Column]  # (rows,) each, of which the first is the wall time in ns
    frames: NDArray[Any]  # (n,) of `logs.FRAME` or `FD_FRAME`
    frames_ns: NDArray[np.int64]  # their wall times (n,)
    entries: Sequence[Entry]

    def write(self, path: Path) -> None:
        """Write the file; OSError."""
        from asammdf import MDF

        with MDF(version="4.10") as file, path.open("w+b") as out:
            header: Any = file.header
            header.abs_time, header.time_flags = self.zero_ns, 0  # UTC
            header.tz_offset = header.daylight_save_time = 0
            if self.table:
                self._add_table(file)
            error = self.frames["id"] & can_id.ERROR != 0
            remote = ~error & (self.frames["id"] & can_id.REMOTE != 0)
            data = ~(error | remote)
            header.comment = frames_sum(self.frames[data], self.frames_ns[data])
            kinds = ("CAN_DataFrame", data), ("CAN_RemoteFrame", remote), ("CAN_ErrorFrame", error)
            for kind, some in kinds:
                if some.any():
                    self._add_frames(file, kind, some)
            file.events.extend(map(self._event, self.entries))
            file.save(out, compression=1)  # deflate

    def _time_s(self, wall_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        time_s: NDArray[np.float64] = (wall_ns - self.zero_ns) / 1e9
        return time_s

    def _add_table(self, file: Any) -> None:
        from asammdf import Signal

        time_s = self._time_s(self.table[0][3])
        channels = [
            Signal(values, time_s, unit, name, comment=text)
            for name, unit, text, values in self.table
        ]
        file.append(channels, acq_name="variables", comment="", common_timebase=True)

    def _add_frames(self, file: Any, kind: str, some: NDArray[np.bool_]) -> None:
        from asammdf import Signal, Source

        frames = self.frames[some]
        columns = {
            "BusChannel": np.full(len(frames), _BUS_CHANNEL),
            "ID": frames["id"] & can_id.ID,
            "IDE": frames["id"] & can_id.EXTENDED != 0,
            "DLC": np.searchsorted(LENGTHS, frames["dlc"]),
            "DataLength": frames["dlc"],
            "Dir": 1 - frames["direction"],  # 0 received, 1 sent
            "DataBytes": frames["data"],
            "EDL": frames["flags"] & Flag.FD != 0,
            "BRS": frames["flags"] & Flag.BRS != 0,
            "ESI": frames["flags"] & Flag.ESI != 0,
        }
        fields = [
            (f"{kind}.{name}", "<u4" if name == "ID" else "u1", values.shape[1:])
            for name, values in columns.items()
        ]
        samples = np.empty(len(frames), fields)
        for (field, *_), values in zip(fields, columns.values(), strict=True):
            samples[field] = values
        bus = Source("CAN", "CAN", "", Source.SOURCE_BUS, Source.BUS_TYPE_CAN)
        time_s = self._time_s(self.frames_ns[some])
        channel = Signal(samples, time_s, name=kind, source=bus)
        channel.master_metadata = "Timestamp", _SECONDS
        file.append(channel, acq_name="CAN", acq_source=bus, comment="")

    def _event(self, entry: Entry) -> Any:
        from asammdf.blocks.v4_blocks import EventBlock

        wall_ns, topic, text = entry
        since_ns = wall_ns - self.zero_ns
        event = EventBlock(event_type=_MARKER, flags=0, sync_base=since_ns, sync_factor=1e-9)
        event.name, event.comment = entry_text(text), json.dumps({"topic": topic, **text})
        return event
