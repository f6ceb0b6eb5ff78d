"""`pcpc log import`: a recording of a CAN bus, and its DBC file, become a log of this project.

    /can/frames   every data frame, known or not, in the order of the bus; sent and received as the
                  recording says, with --node as the DBC file says for this node
    /state        `rx.FRAME.signal`, with --node also `tx.FRAME.signal`: the latest values, a row
                  for each frame of the clock frame; NaN until a signal is first seen
    clock frame   of the most frequent known ids (within 1 %) the one that is heard last, so that a
                  row holds a whole round of a bus on which all is sent once a cycle
    cycle         number of the row; of a frame, that of the first row which may hold it
    stamp         wall time of the recording in ns, also in stamp_ns: one clock

The log has a node `executive` (the recording's side of the bus), the DBC file, and a metadata
record `import` of what was counted. It has no rig, so it cannot be recomputed. Without a DBC file
it has frames only, each with a cycle of its own.
"""

import json
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.errors import Exit, printable
from pcpc.executive.errors import did_you_mean
from pcpc.executive.log import reader as logs
from pcpc.executive.log.channels import register_columns, register_entries
from pcpc.executive.log.mcap_writer import CHUNK_BYTES, BulkWriter, message_records
from pcpc.executive.log.provenance import facts
from pcpc.tools.after.log.commands import ImportRequest
from pcpc.tools.after.log.imported import Imported
from pcpc.tools.after.log.readers.account import DATA_LOST
from pcpc.tools.after.log.recording import ForeignRecording, read
from pcpc.tools.terminal.outfile import LogCommandError, new_file
from pcpc.tools.terminal.progress import Progress

if TYPE_CHECKING:
    from pcpc.tools.after.log.decode import Decoded, DecodedFrames

_ABOUT_AS_MANY = 0.99
_FRAMES_AT_ONCE = 4000  # 71 bytes each as a message
_CDR_HEADER = (0, 1, 0, 0)
_TOLD_IDS = 8


def command(request: ImportRequest) -> int:
    """Carry out `import`; return the exit code. LogCommandError: wrong input."""
    progress = Progress(request.quiet)
    with new_file(request.output, request.force) as path:
        found, unknown = list["DecodedFrames"](), dict[int, int]()
        odd, no_signal, by_pgn = list[str](), list[str](), dict[str, str]()
        if request.dbc is None:
            if request.node is not None:
                raise LogCommandError(f"--node {request.node}: needs --dbc, which names its frames")
            recording = read(request.recording, request.channel, progress)
        else:
            recording, decoded, odd = _decoded(request.dbc, request, progress)
            found, unknown, no_signal = decoded.frames, decoded.unknown, decoded.left_out
            by_pgn = {one.name: f"0x{can_id.text_of(one.word)}" for one in decoded.by_pgn}
        log = _ImportedLog(request, recording, found)
        log.counts["not_in_dbc"], log.counts["no_signal"] = odd, no_signal
        log.counts["by_pgn"] = by_pgn
        log.counts["unknown"] = {f"0x{can_id.text_of(i)}": n for i, n in unknown.items()}
        log.write(path, progress)
    progress.close()
    print(json.dumps(log.counts) if request.json else _report(request, log.counts, unknown))
    if recording.is_whole:
        return Exit.OK
    print(f"{request.recording}: {_loss(recording)}", file=sys.stderr)
    return Exit.LOSS


def _decoded(
    dbc: Path, request: ImportRequest, progress: Progress
) -> "tuple[ForeignRecording, Decoded, list[str]]":
    """Return the recording, what the DBC file makes of it, and its odd entries; LogCommandError."""
    from pcpc.tools.after.log import decode  # here, because they bring the compiler

    database = decode.load(dbc)
    nodes = sorted(database.nodes)
    if request.node is not None and request.node not in nodes:
        hint = did_you_mean(request.node, nodes)
        raise LogCommandError(f"{dbc}: no node {request.node}{hint}")
    recording = read(request.recording, request.channel, progress)
    decoded = decode.by_id(database, recording.frames, progress)
    if not any(len(one.place) for one in decoded.frames):
        ids = _ids(dict(Counter(recording.frames["id"].tolist())))
        raise LogCommandError(
            f"{request.recording}: no frame is one of {dbc}; it has {ids}; "
            "give the DBC file of this bus, or none: then only frames are imported"
        )
    return recording, decoded, [str(one) for one in database.odd]


def _loss(recording: ForeignRecording) -> str:
    """Return in a line what of a recording is not in the log."""
    account = recording.account
    more = f", and {account.damaged - 1} more places" if account.damaged > 1 else ""
    parts = [f"damaged: {account.damage[0]}{more}"] if account.damaged else []
    kinds = [f"{account.left_out[kind]} {kind}" for kind in DATA_LOST if account.left_out[kind]]
    if kinds:
        parts.append(f"not in a log: {', '.join(kinds)} frames")
    if recording.declared:
        parts.append(f"not the {recording.declared} that it declares")
    return f"{'; '.join(parts)}; all else is imported"


class _ImportedLog:
    """The log in the making: rows, columns, directions."""

    def __init__(
        self, request: ImportRequest, recording: ForeignRecording, found: "list[DecodedFrames]"
    ) -> None:
        self.request, self.found = request, found
        self.frames = frames = recording.frames
        self.sent = {id(one) for one in found if request.node in one.message.senders}
        for one in found:
            places = np.flatnonzero(frames["id"] == one.word)
            frames["e2e"][places] = one.state
            if request.node is not None:
                frames["direction"][places] = id(one) not in self.sent
        clock = _clock_frame(found) if found else None
        self.rows = clock.place if clock else np.empty(0, np.int64)
        places = np.arange(len(frames))
        frames["cycle"] = np.searchsorted(self.rows, places) if clock else places
        gaps = np.diff(frames["stamp_ns"][self.rows] if clock else frames["stamp_ns"])
        self.period_ns = max(1, round(float(np.median(gaps)))) if len(gaps) else 1_000_000_000
        self.variables = [
            [f"{'tx' if id(one) in self.sent else 'rx'}.{one.name}.{name}", unit,
             "sent" if id(one) in self.sent else "received", one.name, text]
            for one in found for name, unit, text in one.signals
        ]  # fmt: skip
        account = recording.account
        duration_s = 1e-9 * int(frames["stamp_ns"][-1] - frames["stamp_ns"][0])
        self.counts: Imported = {
            "file": str(request.output), "frames": len(frames),
            "ids": len(np.unique(frames["id"])), "rows": len(self.rows),
            "signals": len(self.variables), "duration_s": round(duration_s, 6),
            "clock_frame": clock.name if clock else "",
            "rate_hz": round(1e9 / self.period_ns, 6),
            "left_out": dict(account.left_out), "others": account.others,
            "damaged": account.damaged, "damage": account.damage, "notes": account.notes,
            "unsorted": recording.order.moved,
            "clock_steps": [
                {"frame": step.frame, "back_s": step.back_ns / 1e9, "shift_s": step.shift_ns / 1e9}
                for step in recording.order.steps
            ],
            "declared": recording.declared,
            "channels": dict(recording.channels),
            "lost": sum(one.lost for one in found if one.checked),
            "not_decoded": sum(len(one.state) - len(one.place) for one in found),
            "foreign_crc": [one.name for one in found if one.foreign_crc],
            "not_in_dbc": [], "no_signal": [], "by_pgn": {}, "unknown": {},
        }  # fmt: skip

    def write(self, path: Path, progress: Progress) -> None:
        """Write the log; OSError."""
        writer = BulkWriter(path)
        try:
            writer.start(profile="ros2")
            self._explain(writer)
            channels = self._register(writer)
            self._messages(writer, channels, progress)
            counts = {
                "written.executive.record": len(self.rows),
                "written.executive.frame": len(self.frames),
            }
            writer.add_metadata("run", {key: str(value) for key, value in counts.items()})
            writer.finish()
        finally:
            writer.file.close()

    def _explain(self, writer: BulkWriter) -> None:
        """Write metadata and attachments as the recorder does."""
        from pcpc.drivers.can import dbc_file  # time

        first_ns = int(self.frames["stamp_ns"][0])
        metadata = facts() | {
            "clock_monotonic_ns": str(first_ns), "clock_wall_ns": str(first_ns),
            "pacing": "imported", "bus": printable(self.request.recording.name),
            "controller": "none", "seed": "0", "rate_hz": repr(self.counts["rate_hz"]),
            "rig": "imported", "period_ns": str(self.period_ns),
            "can_node": self.request.node or "",
        }  # fmt: skip
        writer.add_metadata("executive", metadata)
        counts = {key: json.dumps(value) for key, value in self.counts.items()}
        writer.add_metadata("import", counts)
        names = [row[0] for row in self.variables]
        description = {
            "node": "executive", "rig": "imported", "period_ns": self.period_ns,
            "cycles": len(self.rows), "watch": "", "variables": self.variables, "ranges": {},
            "state_columns": names, "timing_columns": [],
            "frames": {str(one.word): one.name for one in self.found},
            "state_names": [], "fault_names": [], "metadata": metadata,
            **({} if self.most == 8 else {"data_bytes": self.most}),
        }  # fmt: skip
        files = [("executive.json", json.dumps(description).encode())]
        if self.request.dbc is not None:
            files.insert(
                0, (printable(self.request.dbc.name), dbc_file.text(self.request.dbc).encode())
            )
        for name, data in files:
            writer.add_attachment(first_ns, first_ns, name, "text/plain", data)

    @property
    def most(self) -> int:
        """The most data bytes of a frame."""
        return int(self.frames["data"].shape[1])

    def _register(self, writer: BulkWriter) -> tuple[int, int]:
        """Register the topics as the recorder does; return the ids of /state and /can/frames."""
        state = register_columns(writer, "/state", "pcpc/State", self.variables)
        return state, register_entries(writer, "executive", self.most)["can/frames"]

    def _messages(self, writer: BulkWriter, channels: tuple[int, int], progress: Progress) -> None:
        """Write rows and frames in pieces, so that what belongs together lies together."""
        bytes_each = 8 * len(self.variables) + 64
        at_once = max(1, min(_FRAMES_AT_ONCE, CHUNK_BYTES // 2 // bytes_each))
        done, count = 0, len(self.frames)
        for first in range(0, max(1, len(self.rows)), at_once):
            cycle = np.arange(first, min(first + at_once, len(self.rows)))
            last = first + at_once >= len(self.rows)
            end = count if last else int(self.rows[cycle[-1]]) + 1
            for begin in range(done, end, _FRAMES_AT_ONCE):
                some = self.frames[begin : min(begin + _FRAMES_AT_ONCE, end)]
                writer.add([_records(channels[1], some["cycle"], some["stamp_ns"], some)])
            done = end
            if len(cycle):
                stamps = self.frames["stamp_ns"][self.rows[cycle]]
                writer.add([_records(channels[0], cycle, stamps, self._values(cycle))])
            if first:
                progress.show(f"{self.request.output}: {done}/{count} frames")

    def _values(self, cycle: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return all signals at these rows, (rows, signals)."""
        out = np.full((len(cycle), len(self.variables)), np.nan)
        begin = 0
        for one in self.found:
            end = begin + len(one.signals)
            latest = np.searchsorted(one.place, self.rows[cycle], side="right") - 1
            seen = latest >= 0
            out[seen, begin:end] = one.values[latest[seen]]
            begin = end
        return out


def _clock_frame(found: "list[DecodedFrames]") -> "DecodedFrames":
    """Return the frame that makes the rows, see the head of this file."""
    most = max(len(one.place) for one in found)
    frequent = [one for one in found if len(one.place) >= _ABOUT_AS_MANY * most]
    return max(frequent, key=lambda one: int(one.place[0]))


def _records(
    channel: int, cycle: NDArray[np.int64], stamp_ns: NDArray[np.int64], payload: NDArray[Any]
) -> NDArray[Any]:
    """Return message records with the CDR header before each payload."""
    body = np.ascontiguousarray(payload).view(np.uint8).reshape(len(payload), -1)
    data = np.empty((len(payload), logs.CDR_BYTES + body.shape[1]), np.uint8)
    data[:, : logs.CDR_BYTES], data[:, logs.CDR_BYTES :] = _CDR_HEADER, body
    return message_records(channel, cycle, stamp_ns, data)


def _ids(counts: dict[int, int]) -> str:

    most = sorted(counts, key=lambda i: (-counts[i], i))
    shown = ", ".join(f"0x{can_id.text_of(i)} ({counts[i]})" for i in most[:_TOLD_IDS])
    return shown + (f" and {len(most) - _TOLD_IDS} more ids" if len(most) > _TOLD_IDS else "")


def _report(request: ImportRequest, counts: Imported, unknown: dict[int, int]) -> str:
    """Return what was done, and everything that is not as it was in the recording."""
    head = f"{request.output}: {counts['frames']} frames of {counts['ids']} ids in "
    lines = [f"{head}{counts['duration_s']:g} s"]
    if counts["rows"]:
        lines[0] += (
            f"; {counts['rows']} rows of {counts['signals']} signals, "
            f"one for each {counts['clock_frame']} ({counts['rate_hz']:g} Hz)"
        )
    return "\n".join([*lines, *_account_lines(counts), *_decoding_lines(request, counts, unknown)])


def _account_lines(counts: Imported) -> list[str]:
    """Return what of the recording is not in the log, or not as it was."""
    lines = [f"damaged, not imported: {place}" for place in counts["damage"]]
    if counts["damaged"] > len(lines):
        lines.append(f"damaged, not imported: {counts['damaged'] - len(lines)} more places")
    kinds = [f"{n} {kind}" for kind, n in sorted(counts["left_out"].items())]
    if kinds:
        lines.append(f"left out: {', '.join(kinds)} frames")
    if counts["others"]:
        lines.append(f"no frames: {counts['others']} events")
    lines += counts["notes"]
    for step in counts["clock_steps"][:_TOLD_IDS]:
        lines.append(
            f"its clock goes back by {step['back_s']:g} s at frame {step['frame']}: the order "
            f"stays, stamps from there on are {step['shift_s']:g} s later"
        )
    if len(counts["clock_steps"]) > _TOLD_IDS:
        lines.append(f"its clock goes back {len(counts['clock_steps']) - _TOLD_IDS} times more")
    if counts["unsorted"]:
        lines.append(f"stamped out of order, now sorted: {counts['unsorted']} frames")
    if counts["declared"]:
        what = "the recording was cut, changed or damaged since it was written"
        lines.append(f"not the frames that it declares ({counts['declared']}): {what}")
    return lines


def _decoding_lines(request: ImportRequest, counts: Imported, unknown: dict[int, int]) -> list[str]:
    """Return what the DBC file did not decode, and which channels stand together."""
    lines = []
    dbc = request.dbc.name if request.dbc else ""  # without one there are no such lines
    if unknown:
        lines.append(f"not in {dbc}, kept as frames only: {_ids(unknown)}")
    if counts["by_pgn"]:
        found = ", ".join(f"{name} ({word})" for name, word in counts["by_pgn"].items())
        lines.append(f"by their PGN, whatever the priority and source: {found}")
    for odd, what in (
        (counts["not_in_dbc"], "left out of"),
        (counts["no_signal"], "no signals in their frames,"),
    ):
        if odd:
            more = f" and {len(odd) - _TOLD_IDS} more" if len(odd) > _TOLD_IDS else ""
            lines.append(f"{what} {dbc}: {'; '.join(odd[:_TOLD_IDS])}{more}")
    if counts["lost"]:
        lines.append(f"missing by their counters: {counts['lost']} frames")
    if counts["not_decoded"]:
        why = "wrong CRC or length, repeated, out of sequence, or not decodable"
        lines.append(f"kept as frames only: {counts['not_decoded']}; {why}")
    if counts["foreign_crc"]:
        lines.append(f"CRC of another kind, not checked: {', '.join(counts['foreign_crc'])}")
    if request.channel is None and len(counts["channels"]) > 1:
        names = ", ".join(sorted(counts["channels"]))
        lines.append(f"channels {names} are merged; --channel takes one")
    return lines
