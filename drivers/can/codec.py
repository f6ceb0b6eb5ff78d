"""Signals in and out of a frame's data, by the tables of `drivers.can.dbc`; allocates nothing.

    value = float(raw) factor + offset                                              decode
    raw   = round half even((value - offset) / factor), within the limits           encode

The results equal cantools bit for bit. Where cantools uses integers beyond 2^53, int64 is used. NaN
is sent as raw 0. The 8 bytes are one 64 bit word, little-endian for Intel and big-endian for
Motorola signals, in which a signal is a shift and a mask; in a frame of more than 8 bytes, which
CAN FD has, each signal has such a word of its own, from `byte` on. Bytes behind the frame's dlc are
read by no signal and are written as 0. Of a frame with a multiplexer only the signals are read and
written that come with its raw value, and those that always do.
"""

from typing import Any

import numpy as np

from pcpc.drivers.can import can_id
from pcpc.drivers.can.dbc import SignalKind
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.compiled.jit import compiled, inline
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import FLAGS, LENGTH, FrameRow, SignalRow

_TWO_52 = 2.0**52  # float64 from here on are integers
_TWO_63 = 2.0**63
_TOP_BIT = -(2**63)
_ODD_BYTES, _ODD_PAIRS, _LOW_HALF = 0x00FF_00FF_00FF_00FF, 0x0000_FFFF_0000_FFFF, 0xFFFF_FFFF


@inline
def frame_of(word: int, frames: Cells[FrameRow], n_frames: int) -> int:
    """Return which of the first `n_frames` has this id, a word of `can.can_id`; -1 for none.

    `frames`: (rows,) of the tables.
    """
    number, extended = word & can_id.ID, word >> can_id.EXTENDED_BIT
    for row in range(n_frames):
        if frames[row].can_id == number and frames[row].extended == extended:
            return row
    return -1


@inline
def length_of(frame: Cells[Byte], row: int, frames: Cells[FrameRow]) -> int:
    """Return the length of a received frame; -1 if it is classic and its row FD, or without BRS.

    `frame` (bytes,), `frames` (rows,).
    """
    differs = (int64(frame[FLAGS]) ^ frames[row].fd_flags) & (Flag.FD | Flag.BRS)
    return int64(frame[LENGTH]) if differs == 0 else int64(-1)


@inline
def four_bytes(data: Cells[Byte], offset: int) -> int:
    """Return the little-endian word of the 4 bytes from `offset` on: one load where it is known.

    `data`: (n,).
    """
    low = int64(data[offset]) | int64(data[offset + 1]) << int64(8)
    high = int64(data[offset + 2]) | int64(data[offset + 3]) << int64(8)
    return int64(low | high << int64(16))


@inline
def eight_bytes(data: Cells[Byte], at: int) -> int:
    """Return the little-endian word of the 8 bytes of `data` (n,) from `at` on."""
    return int64(four_bytes(data, at) | four_bytes(data, at + 4) << int64(32))


@inline
def put_four_bytes(data: Cells[Byte], offset: int, word: int) -> None:
    """Write a little-endian word into 4 bytes of `data` (n,) from `offset` on."""
    data[offset] = word & 255
    data[offset + 1] = (word >> int64(8)) & 255
    data[offset + 2] = (word >> int64(16)) & 255
    data[offset + 3] = (word >> int64(24)) & 255


@inline
def _add(data: Cells[Byte], offset: int, word: int) -> None:
    """Add the bits of a little-endian word to those of 8 bytes from `offset` on."""
    for i in range(8):
        data[offset + i] |= (word >> int64(8 * i)) & 255


@inline
def swapped_word(word: int) -> int:
    """Return the word with its bytes in the other order."""
    pairs = (word & _ODD_BYTES) << int64(8) | (word >> int64(8)) & _ODD_BYTES
    fours = (pairs & _ODD_PAIRS) << int64(16) | (pairs >> int64(16)) & _ODD_PAIRS
    return int64(fours << int64(32) | (fours >> int64(32)) & _LOW_HALF)


@inline
def _round(x: float) -> float:
    """Round half to even; adding 2^52 leaves no bits for a fraction."""
    size = abs(x)
    if size < _TWO_52:
        size = (size + _TWO_52) - _TWO_52
    return -size if x < 0.0 else size


@inline
def _unscale(raw: int, signal: SignalRow) -> float:
    """Return the physical value of a raw word, already masked and sign-extended."""
    kind, factor, offset = signal.kind, signal.factor, signal.offset
    if kind == SignalKind.SCALED:
        return np.float64(raw) * factor + offset
    if kind == SignalKind.UNSIGNED_64:
        return np.float64(np.int64(raw).view(np.uint64)) * factor + offset
    if kind == SignalKind.FLOAT_32:
        code = np.float64(np.int32(raw).view(np.float32))
    elif kind == SignalKind.FLOAT_64:
        code = np.int64(raw).view(np.float64)
    else:
        return np.float64(raw * signal.int_factor + signal.int_offset)
    if factor == 1.0 and offset == 0.0:
        return code  # keeps the sign of -0.0
    return code * factor + offset


@inline
def _raw_word(data: Cells[Byte], signal: SignalRow) -> int:
    """Return the raw word of a signal in `data` (n,), sign-extended."""
    little = eight_bytes(data, signal.byte)
    word = swapped_word(little) if signal.big_endian != 0 else little
    raw = (word >> signal.shift) & signal.mask
    return int64((raw ^ signal.sign) - signal.sign)


@compiled()
def _unpack_layout(
    data: Cells[Byte],
    frame: int,
    frames: Cells[FrameRow],
    signals: Cells[SignalRow],
    values: Cells[float],
) -> None:
    """Decode the signals that come with the multiplexer's value; the others keep theirs.

    Shapes as in `unpack`.
    """
    layout = _raw_word(data, signals[frames[frame].selector - 1])
    for row in range(frames[frame].first, frames[frame].end):
        signal = signals[row]
        if signal.layout == 0 or signal.layout == layout + 1:
            values[np.uint64(signal.variable)] = _unscale(_raw_word(data, signal), signal)


@inline
def unpack(
    data: Cells[Byte],
    frame: int,
    frames: Cells[FrameRow],
    signals: Cells[SignalRow],
    values: Cells[float],
) -> None:
    """Decode `data` by row `frame` of the tables into the signals' places in `values`.

    `data` (n,) has 8 bytes, or as many as the frame's dlc if that is more; `frames` and `signals`
    (rows,) each, `values` (variables,).
    """
    if frames[frame].selector != 0:
        _unpack_layout(data, frame, frames, signals, values)
        return
    long = frames[frame].dlc > 8
    little = eight_bytes(data, 0)
    big = swapped_word(little)
    for row in range(np.uint64(frames[frame].first), np.uint64(frames[frame].end)):
        signal = signals[row]
        if long:
            little = eight_bytes(data, signal.byte)
            big = swapped_word(little)
        word = big if signal.big_endian != 0 else little
        raw = (word >> signal.shift) & signal.mask
        raw = (raw ^ signal.sign) - signal.sign
        values[np.uint64(signal.variable)] = _unscale(raw, signal)


@inline
def _float_bits(code: float, signal: SignalRow) -> Any:
    """Return the int64 of the nearest number within the limits, as it is on the wire."""
    if code < signal.code_low:
        code = signal.code_low
    elif code > signal.code_high:
        code = signal.code_high
    if signal.kind == SignalKind.FLOAT_32:
        return int64(np.float32(code).view(np.int32))
    return np.float64(code).view(np.int64)


@inline
def _bits(code: float, signal: SignalRow) -> int:
    """Return the int64 of the nearest integer within the limits; `code` is an integer."""
    if code < signal.code_low:
        return signal.bits_low
    if code > signal.code_high:
        return signal.bits_high
    if code < _TWO_63:
        return int64(code)
    return int64(code - _TWO_63) ^ int64(_TOP_BIT)


@inline
def _encoded(value: float, signal: SignalRow) -> tuple[int, int]:
    """Return the raw word of a value, and 1 where it saturated or is NaN, else 0."""
    code = (value - signal.offset) / signal.factor
    kind, bits = signal.kind, int64(0)
    if kind == SignalKind.FLOAT_32 or kind == SignalKind.FLOAT_64:
        if code == code:
            bits = _float_bits(code, signal)
    else:
        code = _round(code)
        if code == code:
            bits = _bits(code, signal)
    return bits, int64(not signal.code_low <= code <= signal.code_high)


@compiled()
def _pack_layout(
    data: Cells[Byte],
    frame: int,
    frames: Cells[FrameRow],
    signals: Cells[SignalRow],
    values: Cells[float],
) -> int:
    """Encode the signals that go with the multiplexer's value; shapes and result as in `pack`."""
    for i in range(max(frames[frame].dlc, int64(8))):
        data[i] = 0
    chosen = signals[frames[frame].selector - 1]
    layout, saturated = _encoded(values[chosen.variable], chosen)[0] & chosen.mask, int64(0)
    for row in range(frames[frame].first, frames[frame].end):
        signal = signals[row]
        if signal.layout == 0 or signal.layout == layout + 1:
            bits, outside = _encoded(values[np.uint64(signal.variable)], signal)
            saturated += outside
            placed = (bits & signal.mask) << signal.shift
            _add(data, signal.byte, swapped_word(placed) if signal.big_endian != 0 else placed)
    return saturated


@inline
def pack(
    data: Cells[Byte],
    frame: int,
    frames: Cells[FrameRow],
    signals: Cells[SignalRow],
    values: Cells[float],
) -> int:
    """Encode the signals of row `frame` from `values` into `data`.

    8 bytes are written, or as many as its dlc if that is more. Returns how many signals saturated:
    the nearest raw value lies outside of its limits, or NaN. `data` (bytes,), `frames` and
    `signals` (rows,) each, `values` (variables,).
    """
    if frames[frame].selector != 0:
        return _pack_layout(data, frame, frames, signals, values)
    little, big, saturated = int64(0), int64(0), int64(0)
    long = frames[frame].dlc > 8
    if long:
        for i in range(frames[frame].dlc):
            data[i] = 0
    for row in range(np.uint64(frames[frame].first), np.uint64(frames[frame].end)):
        signal = signals[row]
        code = (values[np.uint64(signal.variable)] - signal.offset) / signal.factor
        kind, bits = signal.kind, int64(0)
        if kind == SignalKind.FLOAT_32 or kind == SignalKind.FLOAT_64:
            if code == code:
                bits = _float_bits(code, signal)
        else:
            code = _round(code)
            if code == code:
                bits = _bits(code, signal)
        if not signal.code_low <= code <= signal.code_high:
            saturated += 1
        placed = (bits & signal.mask) << signal.shift
        if long:
            _add(data, signal.byte, swapped_word(placed) if signal.big_endian != 0 else placed)
        elif signal.big_endian != 0:
            big |= placed
        else:
            little |= placed
    if long:
        return saturated
    word = little | swapped_word(big)
    put_four_bytes(data, 0, word)
    put_four_bytes(data, 4, word >> int64(32))
    return saturated
