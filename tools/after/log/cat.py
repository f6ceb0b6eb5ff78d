"""`pcpc log export -o -`: the messages of a log as text, as they come, for pipes.

    csv        a topic of columns: time, cycle, a column a variable with its unit; or frames
    ndjson     any topics: an object a message, variables by dotted name; not finite: "nan", "inf"
    candump    frames as `candump -L` writes them

Times are seconds since the executive's first cycle; those of candump are wall time. Numbers have as
many digits as they need to come back bit for bit.
"""

import json
import math
import re
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.errors import Exit
from pcpc.executive.errors import did_you_mean
from pcpc.executive.log import checks as log_checks
from pcpc.executive.log import reader as logs
from pcpc.executive.log.mcap_reader import Scan, walk
from pcpc.tools.after.log import source
from pcpc.tools.after.log.commands import ExportRequest
from pcpc.tools.after.log.contents import DIRECTIONS
from pcpc.tools.after.log.frames import frame_text, payload
from pcpc.tools.after.log.series import EVER_S, label, window_s
from pcpc.tools.after.log.tally import senseless
from pcpc.tools.after.opened import Opened
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

FORMATS = "csv", "ndjson", "candump"
_INTERFACE = re.compile(r"[\w.:@-]{1,15}", re.ASCII)
_LATEST_NS = 20_000_000_000  # frames and events are recorded at most a full ring after their cycle
_FRAMES = "can/frames"
Rows = NDArray[Any]  # messages, or frames: (n,) records


def command(request: ExportRequest) -> int:
    """Print; raises LogError, LogCommandError, BrokenPipeError."""
    path, scanned = request.log, Scan()
    # on a terminal the text itself shows how far it is
    progress = Progress(request.quiet or sys.stdout.isatty())
    start_s, end_s = window_s(request.window)
    zero_ns = first_cycle_ns(path)
    log = Opened(path).head
    topics = [f"/{name.lstrip('/')}" for name in request.topics or []]
    if not topics and log.metadata.get("import", {}).get("rows") == "0":
        topics = [f"/{_FRAMES}"]  # of a recording without a DBC file that is all
    form = request.format or _usual_format(topics)
    topics = topics or {"csv": ["/state"], "candump": [f"/{_FRAMES}"]}.get(form, [])
    _check(form, topics)
    printer = Printer(log, scanned, form, zero_ns)
    is_checked = some = False
    for channel, piece in source.stream(path, scanned, progress):
        topic = scanned.topic(channel)
        if scanned.statistics is not None and not is_checked:
            _check_known(path, scanned, topics)
            is_checked = True
        rows = source.messages(piece)
        time_s = (rows["log_time"].astype(np.int64) - zero_ns) / 1e9
        if time_s[0] - _LATEST_NS / 1e9 > end_s:
            break
        if topic and (not topics or topic in topics):
            rows = rows[(time_s >= start_s) & (time_s < end_s)]
            some = some or len(rows) > 0
            if len(rows):
                sys.stdout.writelines(printer.lines(channel, rows))
    _check_known(path, scanned, topics)
    sys.stdout.flush()
    progress.close()
    if not some and (start_s, end_s) != EVER_S:
        raise LogCommandError(f"{path}: nothing was recorded there; see --topics, --start, --end")
    missing = scanned.missing + printer.left_out()
    for line in missing:
        print(f"{path}: {line}", file=sys.stderr)
    return Exit.LOSS if missing else Exit.OK


def first_cycle_ns(path: Path) -> int:
    """Return the wall time of the executive's first cycle, else of the first message; 0 if none."""
    scanned, first_ns = Scan(), 0
    for channel, piece in walk(path, scanned):
        at_ns = int(source.messages(piece)["log_time"][0])
        if scanned.topic(channel) == "/state":
            return at_ns
        first_ns = first_ns or at_ns
    return first_ns


def _usual_format(topics: list[str]) -> str:
    kinds = {topic.rpartition("/")[2] for topic in topics}
    if len(topics) > 1:
        return "ndjson"
    return "candump" if kinds == {"frames"} else "csv" if kinds <= {"state", "timing"} else "ndjson"


def _check(form: str, topics: list[str]) -> None:
    if form != "ndjson" and len(topics) > 1:
        raise LogCommandError(f"{form} holds one topic; name one, or use --format ndjson")
    if form == "candump" and not topics[0].endswith(_FRAMES):
        raise LogCommandError(f"candump is for frames, not for {topics[0]}; use --format csv")
    if form == "csv" and topics[0].endswith(("/events", "/tunings")):
        raise LogCommandError(f"{topics[0]} has no columns; use --format ndjson")


def _check_known(path: Path, found: Scan, topics: list[str]) -> None:
    known = [channel.topic for channel in found.channels.values()]
    for topic in topics:
        if topic not in known:
            raise LogCommandError(f"{path}: no topic {topic}{did_you_mean(topic, known)}")


@dataclass
class Printer:
    """Turns messages into lines of a format; `zero_ns` is the wall time of t = 0."""

    log: logs.Log  # without messages
    found: Scan
    form: str
    zero_ns: int
    _last: dict[int, int] = field(default_factory=dict)  # channel: cycle
    _variables: dict[str, list[logs.LoggedVariable]] = field(
        default_factory=dict
    )  # topic: its columns
    _names: dict[int, str] = field(default_factory=dict)
    _headed: bool = False
    _left_out: Counter[str] = field(default_factory=Counter)

    def lines(self, channel: int, rows: Rows) -> Iterator[str]:
        """Yield the lines of messages (n,) of one channel."""
        topic = self.found.topic(channel)
        if self.found.channels[channel].message_encoding == "json":
            yield from self._objects(topic, rows)
        elif topic.endswith(_FRAMES):
            yield from self._frames(topic, rows)
        else:
            yield from self._columns(channel, topic, rows)

    def left_out(self) -> list[str]:
        """Return a line for each topic of which messages are not printed: they make no sense."""
        return senseless(self._left_out)

    def _time_s(self, rows: Rows) -> list[float]:
        times: list[float] = ((rows["log_time"].astype(np.int64) - self.zero_ns) / 1e9).tolist()
        return times

    def _cycles(self, channel: int, rows: Rows) -> list[int]:
        """Return the cycles of messages that carry their low 32 bits."""
        sequence = rows["sequence"].astype(np.int64)
        cycles: list[int] = log_checks.unwrapped_cycles(sequence, self._last.get(channel)).tolist()
        self._last[channel] = cycles[-1]
        return cycles

    def _columns(self, channel: int, topic: str, rows: Rows) -> Iterator[str]:
        if topic not in self._variables:
            self._variables[topic] = logs.variables(self.found, topic)
        variables = self._variables[topic]
        if rows["data"].shape[1] != logs.CDR_BYTES + 8 * len(variables):
            self._left_out[topic] += len(rows)
            return
        body = rows["data"][:, logs.CDR_BYTES :].tobytes()
        values = np.frombuffer(body, "<f8").reshape(len(rows), -1).tolist()
        head = zip(self._time_s(rows), self._cycles(channel, rows), values, strict=True)
        if self.form == "csv":
            if not self._headed:
                names = (f"{v.name} {label(v.unit)}" for v in variables)
                yield ",".join(("time [s]", "cycle [1]", *names)) + "\n"
                self._headed = True
            for time_s, cycle, row in head:
                yield f"{time_s!r},{cycle},{','.join(map(repr, row))}\n"
            return
        fields = [v.name for v in variables]
        for time_s, cycle, row in head:
            entry = {"topic": topic, "time_s": time_s, "cycle": cycle}
            yield json_line(entry | dict(zip(fields, row, strict=True)))

    def _frames(self, topic: str, rows: Rows) -> Iterator[str]:
        if rows["data"].shape[1] - logs.CDR_BYTES not in logs.FRAME_SIZES:
            self._left_out[topic] += len(rows)
            return
        data, sane = logs.frames_in(rows)
        self._left_out[topic] += len(rows) - int(sane.sum())
        rows, data = rows[sane], data[sane]
        if self.form == "candump":
            channel = self._interface()
            for wall_ns, frame in zip(rows["log_time"].tolist(), data, strict=True):
                us = (int(wall_ns) + 500) // 1000
                yield f"({us // 10**6}.{us % 10**6:06d}) {channel} {frame_text(frame)}\n"
            return
        if self.form == "csv" and not self._headed:
            yield "time [s],cycle [1],id,name,direction,dlc,e2e,data\n"
            self._headed = True
        self._names = self._names or logs.frame_names(self.log)
        for time_s, frame in zip(self._time_s(rows), data, strict=True):
            entry = {
                "time_s": time_s, "cycle": int(frame["cycle"]),
                "id": can_id.text_of(int(frame["id"])),
                "name": self._names.get(int(frame["id"]), ""),
                "direction": DIRECTIONS[int(frame["direction"]) & 1], "dlc": int(frame["dlc"]),
                "e2e": int(frame["e2e"]), "data": payload(frame),
            }  # fmt: skip
            if self.form == "csv":
                yield ",".join(map(str, entry.values())) + "\n"
            else:
                yield json_line({"topic": topic} | entry)

    def _objects(self, topic: str, rows: Rows) -> Iterator[str]:
        for time_s, row in zip(self._time_s(rows), rows, strict=True):
            entry = self._entry(topic, row["data"].tobytes())
            if entry is None:
                self._left_out[topic] += 1
            else:
                yield json_line({"topic": topic, "time_s": time_s} | entry)

    @staticmethod
    def _entry(topic: str, text: bytes) -> dict[str, Any] | None:
        """Return what an object says, of a keyframe all but its state; None for what is none."""
        if not topic.endswith("/keyframes"):
            return log_checks.entry(text)
        with suppress(ValueError):
            known = log_checks.parse_json(text)
            return {key: value for key, value in known.items() if key != "state"}
        return None

    def _interface(self) -> str:
        """Return the name of the CAN interface of the run, else the kind of bus that it had.

        Of a recording of others that is its channel, if it has one and candump could name it so.
        """
        if "import" in self.log.metadata:
            channels = list(json.loads(self.log.metadata["import"].get("channels", "{}")))
            name = f"can{channels[0]}" if channels and channels[0].isdigit() else "".join(channels)
            return name if len(channels) == 1 and _INTERFACE.fullmatch(name) else "can0"
        for facts in self.log.metadata.values():
            interface, _, channel = facts.get("bus", "").partition(":")
            if interface:
                return channel if interface == "socketcan" and channel else interface
        return "vcan0"


def json_line(entry: dict[str, Any]) -> str:
    """Return one line of JSON, which has no nan and inf: they become text."""
    plain = {
        key: repr(value) if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in entry.items()
    }
    return json.dumps(plain) + "\n"
