"""Frames and signals of a DBC file, as plain records and as flat tables for the compiled loop.

A DBC is the wire contract of a plant. Beyond the format, four signal names have a meaning here:
`crc` (8 bits, last byte) with `counter` or `sequence` (within one byte) make a frame protected; a
`crc` of 16 bits (whole bytes, Intel), behind it the counter's whole byte, is that of AUTOSAR's E2E
profile 5. They are filled and checked by `drivers.can.e2e` and are no variables. The id in a CRC is
the frame's, in one of 16 bits E2EDataId where the message has it. `mode`, where a node receives it,
tells the state of the node above, whose STOP is obeyed. GenMsgSendType "EveryCycle" means once per
cycle of the loop, at any rate; any other send type means every GenMsgCycleTime ms, but "Event"
without one a frame that comes when something happens.

    every_n  = max(1, round(GenMsgCycleTime rate))         cycles from one transmission to the next
    bus load = sum over frames of bits * frames per s / bitrate           bits: `frame_bits`
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.can.dbc_file import Database, DbcSignal, Message, load, parse, place, text
from pcpc.drivers.can.frame_format import check_format, first_bit
from pcpc.drivers.can.frames import Frame, Protection, Signal, SignalKind
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.compiled.rows import FrameRow, SignalRow
from pcpc.drivers.errors import BusError, DbcError, printable

__all__ = [
    "BusError",
    "CodecTable",
    "Database",
    "DbcError",
    "Frame",
    "Message",
    "Protection",
    "Signal",
    "SignalKind",
    "bus_load",
    "first_bit",
    "frame",
    "frames",
    "load",
    "parse",
    "place",
    "real",
    "table",
    "text",
    "used_frame",
]

Way = Literal["rx", "tx"]
_BREAKS = "\n\xa0"  # kept in comments
_LONGEST_MS = 2**31  # between two transmissions of a frame; 25 days; of one without a cycle
_EXACT = 2**53  # every integer up to here is a float64
_FLOAT_MAX = {32: float(np.finfo(np.float32).max), 64: float(np.finfo(np.float64).max)}


@dataclass(frozen=True)
class CodecTable:
    """What the compiled loop walks; `variables` are "FRAME.signal" in order of the signal rows."""

    frames: NDArray[Any]  # FrameRow and SignalRow of drivers.compiled.rows
    signals: NDArray[Any]
    variables: tuple[str, ...]


def frames(database: Database, node: str, direction: Way) -> tuple[Frame, ...]:
    """Return the frames that `node` sends ("tx") or receives ("rx"), by ascending id.

    DbcError: no such node, or an odd entry of the file is about one of its frames.
    """
    if node not in database.nodes:
        known = ", ".join(sorted(database.nodes)) or "none"
        raise DbcError(f"node {node}: not in the DBC file; it has {printable(known)}")
    for one in database.odd:
        if node in one.nodes:
            raise DbcError(f"{database.path}:{one.place}: {one.what}")
    messages = sorted(database.messages, key=lambda message: message.frame_id)
    return tuple(
        used_frame(database, message)
        for message in messages
        if node in (message.senders if direction == "tx" else message.receivers)
    )


def used_frame(database: Database, message: Message) -> Frame:
    """Return a message that a node uses as a record; DbcError also if an odd entry is about it."""
    word = can_id.word_of(message.frame_id, message.is_extended_frame)
    for one in database.odd:
        if one.frame == word:
            raise DbcError(f"{database.path}:{one.place}: {one.what}")
    return frame(message)


@lru_cache(maxsize=1024)  # a rig's nodes ask for the same ones, several times each
def frame(message: Message) -> Frame:
    """Return one message as a record; DbcError if the loop cannot handle it."""
    where = f"frame {message.name}"
    check_format(message, where)
    tail = _tail(message)
    return Frame(
        name=message.name,
        can_id=message.frame_id,
        extended=message.is_extended_frame,
        dlc=message.length,
        cycle_ms=_cycle_ms(message, where),
        has_sequence="sequence" in tail,
        counter=_counter(message.get_signal_by_name(tail[0]), where) if tail else (0, 0, 0),
        crc=_crc(message, tail[0]) if tail else (Protection.UNPROTECTED, 0, 0),
        signals=tuple(
            _signal(s, message.length, where) for s in message.signals if s.name not in tail
        ),
        help=printable(message.comment or "", _BREAKS),
        on_event=_on_event(message),
        flags=_flags(message),
        selector=_selector(message, tail, where),
    )


def _selector(message: Message, tail: Collection[str], where: str) -> str:
    """Return the name of the multiplexer, "" without one; DbcError for more than one level."""
    layered = [signal for signal in message.signals if signal.multiplexer_ids is not None]
    if not layered:
        return ""
    cure = "give each layout a frame of its own"
    for signal in layered:
        if signal.is_multiplexer:
            raise DbcError(f"{where}: {signal.name}: a multiplexer within a layout; {cure}")
        if signal.name in tail:
            raise DbcError(f"{where}: {signal.name}: only in one layout; let it be in all of them")
        if len(signal.multiplexer_ids or ()) != 1:
            raise DbcError(f"{where}: {signal.name}: in more than one layout; {cure}")
    names = {str(signal.multiplexer_signal) for signal in layered}
    if len(names) > 1:
        problem = f"{', '.join(sorted(names))}: more than one multiplexer"
        raise DbcError(f"{where}: {problem}; {cure}")
    multiplexer = message.get_signal_by_name(names.pop())
    scaled = (multiplexer.scale, multiplexer.offset) != (1, 0)
    odd = multiplexer.is_signed or multiplexer.is_float or scaled or multiplexer.length > 32
    if odd or multiplexer.name in tail:
        problem = "a multiplexer must be unsigned, of 32 bits, factor 1, offset 0, and no counter"
        raise DbcError(f"{where}: {multiplexer.name}: {problem}")
    for signal in layered:
        layout = (signal.multiplexer_ids or [0])[0]
        if layout >= 1 << multiplexer.length:
            problem = f"layout {layout} does not fit into the {multiplexer.length} bits"
            raise DbcError(f"{where}: {signal.name}: {problem} of {multiplexer.name}")
    return multiplexer.name


def _flags(message: Message) -> int:
    """Return what a frame's byte 5 says; without CANFD_BRS an FD frame switches its bit rate."""
    if not message.is_fd:
        return Flag.NONE
    own = message.dbc.attributes.get("CANFD_BRS") if message.dbc else None
    of_all = message.dbc.attribute_definitions.get("CANFD_BRS") if message.dbc else None
    switch = own.value if own else of_all and of_all.default_value
    return Flag.FD | (Flag.NONE if str(switch) == "0" else Flag.BRS)


def _on_event(message: Message) -> bool:
    return message.send_type == "Event" and not message.cycle_time


def _cycle_ms(message: Message, where: str) -> float:
    """Return the time from one transmission to the next, 0 for every cycle of the loop."""
    if message.send_type == "EveryCycle":
        return 0.0
    if _on_event(message):
        return float(_LONGEST_MS)
    if not message.cycle_time:
        raise DbcError(f'{where}: give a GenMsgCycleTime, or GenMsgSendType "EveryCycle"')
    if not isinstance(message.cycle_time, int | float) or not 0 < message.cycle_time <= _LONGEST_MS:
        given = printable(repr(message.cycle_time)[:40])
        raise DbcError(f"{where}: GenMsgCycleTime {given}; expected 1 to {_LONGEST_MS} ms")
    return float(message.cycle_time)


def _tail(message: Message) -> tuple[str, ...]:
    """Return (counter or sequence, crc) of a protected frame, () of another."""
    signals = {signal.name: signal for signal in message.signals}
    crc = signals.get("crc")
    if crc is None:
        return ()
    start = 8 * (message.length - 1) + (7 if crc.byte_order == "big_endian" else 0)
    if crc.length != 16 and (crc.length != 8 or crc.start != start):
        what = "crc must be the 8 bits of the last byte, or 16 bits"
        raise DbcError(f"frame {message.name}: {what}")
    for name in ("counter", "sequence"):
        if name in signals:
            return name, "crc"
    raise DbcError(f"frame {message.name}: has a crc but no counter or sequence; add one")


def _crc(message: Message, counter: str) -> tuple[int, int, int]:
    """Return which CRC a protected frame has, where, and the id that it is over."""
    crc, where = message.get_signal_by_name("crc"), f"frame {message.name}"
    if crc.length == 8:
        return Protection.CRC_8, message.length - 1, message.frame_id
    crc_byte = crc.start // 8
    counter_follows = (crc_byte + 2, 0, 255) == _counter(message.get_signal_by_name(counter), where)
    if crc.start % 8 or crc.byte_order == "big_endian" or not counter_follows:
        problem = "a crc of 16 bits takes two whole bytes (Intel), and the one behind it is"
        raise DbcError(f"{where}: {problem} the {counter}'s, as in AUTOSAR's E2E profile 5")
    attribute = message.dbc.attributes.get("E2EDataId") if message.dbc else None
    data_id = message.frame_id & 0xFFFF if attribute is None else attribute.value
    if not isinstance(data_id, int) or not 0 <= data_id <= 0xFFFF:
        raise DbcError(f"{where}: E2EDataId {printable(repr(data_id)[:40])}; expected 0 to 65535")
    return Protection.CRC_16, crc_byte, data_id


def _counter(signal: DbcSignal, where: str) -> tuple[int, int, int]:
    """Return (byte, shift, mask) of the counter."""
    byte, bit = divmod(signal.start, 8)
    shift = bit - signal.length + 1 if signal.byte_order == "big_endian" else bit
    if shift < 0 or shift + signal.length > 8 or signal.is_signed:
        raise DbcError(f"{where}: {signal.name} must be unsigned and lie within one byte")
    return byte, shift, (1 << signal.length) - 1


def _signal(signal: DbcSignal, dlc: int, where: str) -> Signal:
    where = f"{where}: {signal.name}"
    begins, first = signal.start, first_bit(signal)
    factor, offset = real(signal.scale), real(signal.offset)
    if factor == 0 or not math.isfinite(factor) or not math.isfinite(offset):
        problem = f"factor {factor}, offset {offset}; must be finite, factor not 0"
        raise DbcError(f"{where}: {problem}; correct (factor,offset)")
    kind = _kind(signal, where)
    if first - 8 * word_place(begins // 8, dlc) + signal.length > 64:
        problem = f"{signal.length} bits lie in 9 bytes; begin it with a byte"
        raise DbcError(f"{where}: {problem}")
    full: tuple[float, float] = (0, (1 << signal.length) - 1)
    if signal.is_float:
        full = (-_FLOAT_MAX[signal.length], _FLOAT_MAX[signal.length])
    elif signal.is_signed:
        full = (-(1 << signal.length - 1), (1 << signal.length - 1) - 1)
    codes, limits = full, sorted(float(code) * factor + offset for code in full)
    if not (signal.is_float or all(map(math.isfinite, limits))):
        raise DbcError(f"{where}: factor {factor} gives infinite values; correct (factor,offset)")
    if signal.minimum is not None and signal.maximum is not None:
        limits = [real(signal.minimum), real(signal.maximum)]
        raw = sorted((limit - offset) / factor for limit in limits)
        low, high = (code if signal.is_float or math.isinf(code) else round(code) for code in raw)
        codes = (max(full[0], low), min(full[1], high))
    if not limits[0] <= limits[1] or not codes[0] <= codes[1]:
        problem = f"no raw value lies in [{limits[0]}|{limits[1]}]"
        raise DbcError(f"{where}: {problem}; correct [minimum|maximum]; [0|0] means no limit")
    return Signal(
        signal.name,
        printable(signal.unit or ""),
        printable(signal.comment or "", _BREAKS),
        limits[0],
        limits[1],
        factor,
        offset,
        signal.start,
        signal.length,
        signal.byte_order == "big_endian",
        signal.is_signed,
        signal.is_float,
        kind,
        codes,
        {int(k): str(v) for k, v in (signal.choices or {}).items()},
        signal.multiplexer_ids[0] if signal.multiplexer_ids else None,
    )


def real(number: float) -> float:
    """Return a number of a DBC file as float64; an integer beyond is infinite."""
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf


def _kind(signal: DbcSignal, where: str) -> SignalKind:
    """Return in what arithmetic the float64 value of this signal is the one of cantools.

    cantools computes integer factors and offsets in integers of any size. Up to 2^53 float64
    agrees; beyond, int64 does where it holds the result; the rest is refused.
    """
    if signal.is_float:
        if signal.length not in (32, 64):
            raise DbcError(f"{where}: float of {signal.length} bits; use 32 or 64")
        return SignalKind.FLOAT_32 if signal.length == 32 else SignalKind.FLOAT_64
    unsigned_64 = signal.length == 64 and not signal.is_signed
    in_floats = SignalKind.UNSIGNED_64 if unsigned_64 else SignalKind.SCALED
    whole_offset = float(signal.offset).is_integer()
    if not (isinstance(signal.scale, int) or (signal.scale.is_integer() and whole_offset)):
        return in_floats
    largest = abs(int(signal.scale)) << (signal.length - signal.is_signed)
    if largest <= _EXACT and abs(signal.offset) <= _EXACT:
        return in_floats
    if abs(signal.scale) == 1 and (signal.offset == 0 or not whole_offset):
        return in_floats
    if not whole_offset or unsigned_64 or largest + abs(int(signal.offset)) >= 2**63:
        raise DbcError(f"{where}: scaled values exceed 64 bits; use fewer bits")
    return SignalKind.WIDE


def table(
    selected: Sequence[Frame], rate_hz: float, index: Mapping[str, int] | None = None
) -> CodecTable:
    """Return the tables of these frames.

    `index` gives the place of each variable "FRAME.signal"; without, they are counted from 0.
    """
    rows: list[tuple[int, ...]] = []
    signals: list[tuple[float, ...]] = []
    names: list[str] = []
    for entry in selected:
        first = len(signals)
        for signal in entry.signals:
            names.append(f"{entry.name}.{signal.name}")
            place = len(signals) if index is None else index[names[-1]]
            signals.append(_signal_row(signal, place, entry.dlc))
        rows.append((
            entry.can_id, entry.extended, entry.dlc, entry.flags, first, len(signals),
            entry.every_n(rate_hz), entry.crc[0], entry.has_sequence, *entry.counter,
            *entry.crc[1:], _selector_row(entry, first),
        ))  # fmt: skip
    return CodecTable(
        np.array(rows, FrameRow.dtype), np.array(signals, SignalRow.dtype), tuple(names)
    )


def _selector_row(entry: Frame, first: int) -> int:
    names = [signal.name for signal in entry.signals]
    return 1 + first + names.index(entry.selector) if entry.selector else 0


def _signal_row(signal: Signal, place: int, dlc: int) -> tuple[float, ...]:
    mask = (1 << signal.nbits) - 1
    byte = word_place(signal.start // 8, dlc)
    start = signal.start - 8 * byte
    from_top = start // 8 * 8 + 7 - start % 8
    shift = 64 - from_top - signal.nbits if signal.big_endian else start
    extends = (signal.signed or signal.is_float) and signal.nbits < 64
    wide = signal.kind == SignalKind.WIDE
    bits = [0, 0] if signal.is_float else [_wrap(int(code) & mask) for code in signal.codes]
    return (
        byte, signal.big_endian, shift, _wrap(mask),
        1 << (signal.nbits - 1) if extends else 0, signal.kind, place,
        int(signal.factor) if wide else 0, int(signal.offset) if wide else 0, *bits,
        0 if signal.layout is None else 1 + signal.layout,
        signal.factor, signal.offset, *_float_codes(signal),
    )  # fmt: skip


def word_place(byte: int, dlc: int) -> int:
    """Return the first of the 8 bytes in which a signal that begins in `byte` lies."""
    return min(byte, dlc - 8) if dlc > 8 else 0


def _wrap(word: int) -> int:
    """Return the int64 of the same bits as an unsigned 64 bit word."""
    return word - 2**64 if word >= 2**63 else word


def _float_codes(signal: Signal) -> tuple[float, float]:
    """Return the outermost float64 values within the raw limits; the lowest one always is such."""
    low, high = (float(code) for code in signal.codes)
    if high > signal.codes[1]:
        high = math.nextafter(high, -math.inf)
    return low, high


def bus_load(
    database: Database,
    rate_hz: float,
    bitrate: float,
    names: Collection[str] | None = None,
    data_bitrate: float | None = None,
) -> float:
    """Return the worst-case load by all frames, or `names`, as a fraction of `bitrate` in bit/s.

    DbcError: an FD frame switches its bit rate, and there is no `data_bitrate`.
    """
    bits_per_s = 0.0
    for message in database.messages:
        if names is not None and message.name not in names:
            continue
        entry = frame(message)
        frames_per_s = 1000 / entry.cycle_ms if entry.cycle_ms else rate_hz
        nominal, data = entry.bits()
        if data and data_bitrate is None:
            what = "CAN FD with a bit rate switch; give the rig bus.data_bitrate, in bit/s"
            raise DbcError(f"frame {entry.name}: {what}")
        bits_per_s += nominal * frames_per_s
        bits_per_s += frames_per_s * data * bitrate / data_bitrate if data_bitrate else 0.0
    return bits_per_s / bitrate
