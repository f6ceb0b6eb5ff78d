"""The signals of recorded frames, by id, with the frame's multiplexers on any number of levels.

    value      raw factor + offset, as cantools computes it, in integers where both are
    column     of a signal; two of one name have one column if no frame has both and their units
               agree, else each has its first bit behind its name
    layout     a signal that a frame does not have keeps its value, at first NaN
    length     a frame that is shorter than its description is not decoded; a longer one is
    protected  counter and CRC are checked by the loop's rules and are no signals; what is not OK
               is not decoded. If more than half of an id's frames fail, then their CRC is another
               one: they are decoded unchecked, and the report says so
    J1939      where no frame has a recorded id, the one that has its PGN: priority, source and
               destination are free. Of several with this PGN only that of the same source

A cycle time is not asked for, and signals may overlap.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id, dbc, e2e
from pcpc.drivers.can.dbc_file import Database, DbcSignal, Message
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.compiled.jit import compiled
from pcpc.drivers.errors import BusError
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

_EXACT = 2**53  # every integer up to here is a float64
_FLOATS = {16: "<f2", 32: "<f4", 64: "<f8"}
_ADDRESSED = 240  # PDU formats below have a destination in the place of the group extension


@dataclass(frozen=True)
class DecodedFrames:
    """The frames of one id.

    `word`: the id, see can_id; `name`: of the frame in the log. `signals`: name, unit, help.
    `place` (n,): of the decoded ones among all frames; `values` (n, signals). `state`: of all of
    this id, as in drivers.can.e2e. `lost`: by the counters.
    """

    message: Message
    word: int
    name: str
    signals: list[tuple[str, str, str]]
    place: NDArray[np.int64]
    values: NDArray[np.float64]
    state: NDArray[np.int64]
    lost: int
    checked: bool  # by the loop's own rules
    foreign_crc: bool


@dataclass(frozen=True)
class Decoded:
    """The decoded ids, by id; how many frames of each other id; ids that were found by PGN.

    `left_out`: signals that no frame can have.
    """

    frames: list[DecodedFrames]
    unknown: dict[int, int]
    by_pgn: list[DecodedFrames]
    left_out: list[str]


@dataclass
class _Layouts:
    """Which frames have which signal: `raw` values of the multiplexers, by name."""

    data: NDArray[np.uint8]
    message: Message
    raw: dict[str, NDArray[np.uint64]] = field(default_factory=dict)

    def present(self, signal: DbcSignal) -> NDArray[np.bool_]:
        """Return which frames have a signal, (n,)."""
        if signal.multiplexer_signal is None or signal.multiplexer_ids is None:
            return np.ones(len(self.data), bool)
        name = str(signal.multiplexer_signal)
        chooser = next(s for s in self.message.signals if s.is_multiplexer and s.name == name)
        if name not in self.raw:
            self.raw[name] = _raw_of(self.data, chooser)
        chosen = np.isin(self.raw[name], np.array(signal.multiplexer_ids, np.uint64))
        return chosen & self.present(chooser)


def load(path: Path) -> Database:
    """Read a DBC file; LogCommandError if it is none."""
    try:
        return dbc.load(path)
    except BusError as error:
        raise LogCommandError(str(error)) from None


def by_id(database: Database, frames: NDArray[Any], progress: Progress) -> Decoded:
    """Decode recorded frames, (n,) records (logs.FRAME)."""
    ids, which, counts = np.unique(frames["id"], return_inverse=True, return_counts=True)
    order = np.argsort(which, kind="stable")
    places = np.split(order, np.cumsum(counts)[:-1])
    meant = {word: _message_of(word, database) for word in ids.tolist()}
    times = Counter(id(message) for message in meant.values())
    decoded, unknown, left_out = [], {}, list[str]()
    for word, count, rows in zip(ids.tolist(), counts.tolist(), places, strict=True):
        message = meant[word]
        if message is None:
            unknown[word] = count
            continue
        name = message.name
        if times[id(message)] > 1:
            name = f"{name}_{word & can_id.ID:X}"
        progress.show(f"{name}: {count} frames")
        odd = [one for one in message.signals if not _is_possible(one, message)]
        left_out += [f"{name}.{one.name} ({one.start}|{one.length})" for one in odd]
        decoded.append(_decoded(message, word, name, frames[rows], rows))
    by_pgn = [one for one in decoded if one.word != _word(one.message)]
    return Decoded(decoded, unknown, by_pgn, left_out)


def _word(message: Message) -> int:
    return can_id.word_of(message.frame_id, message.is_extended_frame)


def _message_of(word: int, database: Database) -> Message | None:
    """Return the message of an id, in J1939 else that of its PGN; None if there is none."""
    exact = next((one for one in database.messages if _word(one) == word), None)
    if exact is not None or not word & can_id.EXTENDED:
        return exact
    same = [
        one for one in database.messages
        if one.is_extended_frame and (database.j1939 or one.protocol == "j1939")
        and pgn_of(one.frame_id) == pgn_of(word)
    ]  # fmt: skip
    if len(same) > 1:
        same = [one for one in same if (one.frame_id ^ word) & 0xFF == 0]
    return same[0] if len(same) == 1 else None


def pgn_of(word: int) -> int:
    """Return the parameter group number of J1939 of an id of 29 bits."""
    group = word >> 8 & 0x3FFFF
    return group if group >> 8 & 0xFF >= _ADDRESSED else group & 0x3FF00


@compiled()
def _check(data: Any, length: Any, frames: Any, state: Any, outcome: Any) -> int:
    lost = 0
    for i in range(data.shape[0]):
        outcome[i], before = e2e.check(data[i], length[i], 0, frames, state)
        lost += before
    return lost


def _decoded(
    message: Message, word: int, name: str, frames: NDArray[Any], place: NDArray[np.int64]
) -> DecodedFrames:
    """Decode the frames of one id; `place` are their places among all frames. Both (n,)."""
    frame = _protected_frame(message)
    length = frames["dlc"].astype(np.int64)
    data = np.ascontiguousarray(frames["data"])
    state = np.where(length < message.length, FrameState.ERROR, FrameState.OK).astype(np.int64)
    right, lost, foreign = length == message.length, 0, False
    if frame is not None and frame.dlc <= data.shape[1]:
        judged = np.zeros(len(frames), np.int64)
        row = dbc.table([frame], 1.0).frames
        lost = int(_check(data, length, row, e2e.new_state(1), judged))
        foreign = 2 * int((judged[right] == FrameState.ERROR).sum()) > int(right.sum())
        unchecked = np.where(right, FrameState.NOT_AVAILABLE, FrameState.ERROR)
        state = unchecked.astype(np.int64) if foreign else judged
    used = np.isin(state, (FrameState.OK, FrameState.OK_SOME_LOST, FrameState.NOT_AVAILABLE))
    hidden = () if frame is None else ("crc", "sequence" if frame.has_sequence else "counter")
    shown = [one for one in message.signals if one.name not in hidden]
    shown = [one for one in shown if _is_possible(one, message)]
    signals, values = _columns(message, shown, data[used])
    lost, checked = 0 if foreign else lost, frame is not None and not foreign
    return DecodedFrames(
        message, word, name, signals, place[used], values, state, lost, checked, foreign
    )


def _protected_frame(message: Message) -> dbc.Frame | None:
    """Return a message with counter and CRC as the loop has it; None of another."""
    if not any(signal.name == "crc" for signal in message.signals):
        return None
    if not message.cycle_time and message.send_type != "EveryCycle":
        message.cycle_time = 1  # the loop wants one
    try:
        frame = dbc.frame(message)
    except BusError:
        return None
    return frame if frame.protected else None


def _columns(
    message: Message, shown: Sequence[DbcSignal], data: NDArray[np.uint8]
) -> tuple[list[tuple[str, str, str]], NDArray[np.float64]]:
    """Return name, unit and help of each column, and what it holds, (n, columns)."""
    layouts, names = _Layouts(data, message), column_names(shown)
    columns = list(dict.fromkeys(names))
    values = np.full((len(data), len(columns)), np.nan)
    for i, name in enumerate(columns):
        latest = np.full(len(data), -1)
        for signal in (one for one, own in zip(shown, names, strict=True) if own == name):
            present = layouts.present(signal)
            values[present, i] = _values_of(data[present], signal)
            latest[present] = np.flatnonzero(present)
        latest = np.maximum.accumulate(latest)
        values[:, i] = values[latest, i]  # before the first, -1: whatever the last is
        values[latest < 0, i] = np.nan
    first = [shown[names.index(name)] for name in columns]
    about = [(one.unit or "", one.comment or "") for one in first]
    return [(name, *more) for name, more in zip(columns, about, strict=True)], values


def column_names(signals: Sequence[DbcSignal]) -> list[str]:
    """Return the column of each signal: its name, unless another one has it in the same frame."""
    names: list[str] = []
    every = Counter(one.name for one in signals)
    for signal in signals:
        same = [one for one in signals if every[one.name] > 1 and one.name == signal.name]
        alike = all(one is other or _are_one(one, other) for one in same for other in same)
        names.append(signal.name if alike else f"{signal.name}_{signal.start}")
    counts = Counter(names)
    for i, name in enumerate(names):
        if counts[name] > 1 and name != signals[i].name:  # begin with the same bit
            names[i] = f"{name}_{i}"
    return names


def _are_one(one: DbcSignal, other: DbcSignal) -> bool:
    """Return whether two signals of one name can share a column."""
    if one.multiplexer_signal != other.multiplexer_signal or one.unit != other.unit:
        return False
    return set(one.multiplexer_ids or [-1]).isdisjoint(other.multiplexer_ids or [-1])


def _is_possible(signal: DbcSignal, message: Message) -> bool:
    """Return whether a frame can hold a signal, and a number its value."""
    lies_in = dbc.first_bit(signal) + signal.length <= 8 * message.length
    is_finite = isfinite(dbc.real(signal.scale)) and isfinite(dbc.real(signal.offset))
    return (
        is_finite
        and lies_in
        and (signal.length in _FLOATS if signal.is_float else signal.length <= 64)
    )


def _raw_of(data: NDArray[np.uint8], signal: DbcSignal) -> NDArray[np.uint64]:
    """Return the bits of a signal in `data` (n, bytes), from 0 on, (n,)."""
    first, raw = dbc.first_bit(signal), np.zeros(len(data), np.uint64)
    end = first + signal.length
    for byte in range(first // 8, (end + 7) // 8 if len(data) else 0):
        low, high = max(first, 8 * byte) - 8 * byte, min(end, 8 * byte + 8) - 8 * byte
        word = data[:, byte].astype(np.uint64)
        if signal.byte_order == "big_endian":
            part = word >> np.uint64(8 - high) & np.uint64((1 << high - low) - 1)
            raw |= part << np.uint64(end - 8 * byte - high)
        else:
            part = word >> np.uint64(low) & np.uint64((1 << high - low) - 1)
            raw |= part << np.uint64(8 * byte + low - first)
    return raw


def _values_of(data: NDArray[np.uint8], signal: DbcSignal) -> NDArray[np.float64]:
    """Return what a signal says in `data` (n, bytes), (n,), in the arithmetic of cantools."""
    raw, scale, offset = _raw_of(data, signal), signal.scale, signal.offset
    if signal.is_float:
        kind = _FLOATS[signal.length]
        code = raw.astype(f"<u{signal.length // 8}").view(kind).astype(float)
        return code if (scale, offset) == (1, 0) else code * dbc.real(scale) + dbc.real(offset)
    code = raw
    if signal.is_signed:
        away = np.uint64(64 - signal.length)
        code = (raw << away).view(np.int64) >> np.int64(away)
    largest = abs(scale) * 2**signal.length + abs(offset)
    if isinstance(scale, int) and largest > _EXACT:
        return np.array([dbc.real(one * scale + offset) for one in code.tolist()], float)
    return np.asarray(code.astype(float) * dbc.real(scale) + dbc.real(offset))
