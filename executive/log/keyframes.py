"""Keyframes in a log: from the newest before a cycle a node is recomputed, not from its start.

    record: {keyframe: 1s}     in a rig file, the default; 0s for none
    /keyframes                 JSON: cycle, stamp_ns, passes, layout, crc, state

`state` is what `executive.nodes.planned_keyframes` lists, packed with zstd, in base64; `crc` is the
CRC-32 of what was packed; `layout` names what lies where. One that is damaged, of another layout,
or of values that no node goes on from is left out and named, and the one before it serves. Where
all have another layout, the node is recomputed from its start.
"""

import base64
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import zstandard
from msgspec import Meta
from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.executive.log.description import LATEST, node_description
from pcpc.executive.log.mcap_records import MESSAGE_HEAD, message_dtype
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.layout import KEYFRAME_HEAD

_TRIES = 20  # copies of one that is being written meanwhile
_BACK_NS = 3 * 10**8  # that a search goes back at first, besides one distance of keyframes
_MARGIN_NS = 2 * 10**8  # of the time of a cycle that follows from its number
_OTHER_LAYOUT = "its layout is of another version or another rig"

_Count = Annotated[int, Meta(ge=0, le=LATEST)]


class _Entry(msgspec.Struct):
    """What a log says of a keyframe."""

    cycle: _Count
    passes: _Count
    layout: str
    crc: int
    state: str


@dataclass(frozen=True)
class Keyframe:
    """What a node carried out of a cycle. `stamp_ns`: of that cycle, of a log its log time."""

    cycle: int
    passes: int
    stamp_ns: int
    state: bytes


class Keyframes:
    """Those that a node publishes; an observer of `log.observers`."""

    word, topic, waits = "keyframe", "keyframes", True

    def __init__(self, block: sh.NodeMemory) -> None:
        description = node_description(block.description)
        self._block, self._seen = block, 0
        self._bytes = description["keyframe_bytes"] if description.get("keyframe_passes") else 0
        self._layout = description.get("keyframe_layout", "")

    @property
    def schema(self) -> str | None:
        """Return the name of their schema, None of a node without."""
        return "Keyframe" if self._bytes else None

    def look(self) -> Iterator[tuple[int, int, dict[str, Any]]]:
        """Yield stamp, cycle and entry of the newest one."""
        if (frame := self.newest()) is not None:
            entry = _packed_state(frame.passes, self._layout, frame.state)
            yield frame.stamp_ns, frame.cycle, entry

    def newest(self) -> Keyframe | None:
        """Return the newest one; None if it is known, or in the making.

        One that was overwritten since the last look is missed.
        """
        for _ in range(_TRIES if self._bytes else 0):
            seq = int(self._block["keyframe_seq"][0])
            if seq == self._seen:
                return None
            whole = self._block["keyframe"].view(np.uint8)
            data = whole[: 8 * KEYFRAME_HEAD + self._bytes].tobytes()
            if seq & 1 or int(self._block["keyframe_seq"][0]) != seq:
                continue
            self._seen = seq
            passes, cycle, stamp = map(int, np.frombuffer(data, "<i8", KEYFRAME_HEAD))
            return Keyframe(cycle, passes, stamp, data[8 * KEYFRAME_HEAD :])
        return None


def _packed_state(passes: int, layout: str, state: bytes) -> dict[str, Any]:
    text = base64.b64encode(zstandard.compress(state)).decode()
    return {"passes": passes, "layout": layout, "crc": zlib.crc32(state), "state": text}


def newest(
    head: logs.Log,
    role: str,
    before: int,
    layout: str,
    why_not: Callable[[bytes], str],
    notes: list[str],
) -> Keyframe | None:
    """Return the newest keyframe of a node behind a cycle earlier than `before`; None without.

    `layout`: of this node's here. `why_not` says why a state is none, or "". `notes` gets what was
    left out, in a line. LogError.
    """
    description = head.node[role].description
    period = description["period_ns"]
    every_ns = description.get("keyframe_passes", 0) * period
    if every_ns and description.get("keyframe_layout") != layout:
        notes.append(f"the keyframes of the {role} are left out: {_OTHER_LAYOUT}")
        return None
    first = _first_cycle(head.path, role) if every_ns else None
    if first is None:
        return None
    size = description.get("keyframe_bytes", 0)
    at_ns, back_ns = first[1] + (before - first[0]) * period, every_ns + _BACK_NS
    while True:
        refusals: list[str] = []
        good = None
        for log_ns, text in _entries(
            head.path, role, (max(at_ns - back_ns, 0), at_ns + _MARGIN_NS)
        ):
            try:
                keyframe = keyframe_of(text, log_ns, size, layout, before)
                if keyframe is not None and (what := why_not(keyframe.state)):
                    raise ValueError(f"cycle {keyframe.cycle}, {what}")
                good = keyframe or good
            except ValueError as error:
                refusals.append(str(error))
        if good is not None or at_ns - back_ns < first[1]:
            if refusals:
                more = f"; and {len(refusals) - 1} more" if len(refusals) > 1 else ""
                notes.append(f"a keyframe of the {role} is left out: {refusals[-1]}{more}")
            return good
        back_ns *= 4


def keyframe_of(
    text: bytes, stamp_ns: int, size: int, layout: str, before: int = LATEST
) -> Keyframe | None:
    """Return the keyframe of an entry, None if it is not of a cycle earlier than `before`.

    ValueError, in words, for one that is damaged or of another layout.
    """
    try:
        entry = msgspec.json.decode(text, type=_Entry)
        if entry.cycle >= before:
            return None
        cycle = f"cycle {entry.cycle}"
        if entry.layout != layout:
            raise ValueError(f"{cycle}, {_OTHER_LAYOUT}")
        packed = base64.b64decode(entry.state, validate=True)
        if zstandard.frame_content_size(packed) != size:
            raise ValueError(f"{cycle}, its state does not have {size} bytes")
        state = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    except (msgspec.DecodeError, zstandard.ZstdError) as error:
        raise ValueError(str(error)) from None
    if zlib.crc32(state) != entry.crc:
        raise ValueError(f"{cycle}, its checksum does not match")
    return Keyframe(entry.cycle, entry.passes, stamp_ns, state)


def _entries(path: Path, role: str, only: logs.Times) -> Iterator[tuple[int, bytes]]:
    """Yield log time and text of the keyframes of a node between two log times."""
    for rows in _rows(path, logs.topic(role, "keyframes"), only):
        for row in rows:
            time = row[:MESSAGE_HEAD].view(message_dtype(0))["log_time"][0]
            yield int(time), row[MESSAGE_HEAD:].tobytes()


def _first_cycle(path: Path, role: str) -> tuple[int, int] | None:
    """Return number and log time of the first cycle of a node in a log, None without one."""
    for rows in _rows(path, logs.topic(role, "state"), (0, LATEST)):
        message = rows[0, :MESSAGE_HEAD].view(message_dtype(0))
        return int(message["sequence"][0]), int(message["log_time"][0])
    return None


def _rows(path: Path, topic: str, only: logs.Times) -> Iterator[NDArray[np.uint8]]:
    found = logs.Scan()
    for channel, rows in logs.walk(path, found, only):
        if found.topic(channel) == topic:
            yield np.ascontiguousarray(rows)
