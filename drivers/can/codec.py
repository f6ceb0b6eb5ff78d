"""Signals in and out of 8 data bytes, by the tables of `drivers.can.dbc`; allocates nothing.

    value = float(raw) factor + offset                                              decode
    raw   = round half even((value - offset) / factor), within the limits           encode

The results equal cantools bit for bit. Where cantools uses integers beyond 2^53, int64 is used. NaN
is sent as raw 0. The 8 bytes are one 64 bit word, little-endian for Intel and big-endian for
Motorola signals, in which a signal is a shift and a mask. Bytes behind the frame's dlc are read by
no signal and are written as 0.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id, dbc
from pcpc.drivers.compiled.jit import inline

_TWO_52 = 2.0**52  # float64 from here on are integers
_TWO_63 = 2.0**63
_TOP_BIT = -(2**63)


@inline
def frame_of(word: int, frames: NDArray[Any], n_frames: int) -> int:
    """Return which of the first `n_frames` has this id, a word of `can.can_id`; -1 for none."""
    number, extended = word & can_id.ID, word >> can_id.EXTENDED_BIT
    for row in range(n_frames):
        if frames[row].can_id == number and frames[row].extended == extended:
            return row
    return -1


@inline
def _little(data: NDArray[np.uint8]) -> np.int64:
    word = np.int64(0)
    for i in range(8):
        word |= np.int64(data[i]) << np.int64(8 * i)
    return word


@inline
def _big(data: NDArray[np.uint8]) -> np.int64:
    word = np.int64(0)
    for i in range(8):
        word |= np.int64(data[i]) << np.int64(56 - 8 * i)
    return word


@inline
def _round(x: float) -> float:
    """Round half to even; adding 2^52 leaves no bits for a fraction."""
    size = abs(x)
    if size < _TWO_52:
        size = (size + _TWO_52) - _TWO_52
    return -size if x < 0.0 else size


@inline
def _unscale(raw: np.int64, signal: Any) -> float:
    """Return the physical value of a raw word, already masked and sign-extended."""
    kind, factor, offset = signal.kind, signal.factor, signal.offset
    if kind == dbc.SCALED:
        return np.float64(raw) * factor + offset
    if kind == dbc.UNSIGNED_64:
        return np.float64(np.int64(raw).view(np.uint64)) * factor + offset
    if kind == dbc.FLOAT_32:
        code = np.float64(np.int32(raw).view(np.float32))
    elif kind == dbc.FLOAT_64:
        code = np.int64(raw).view(np.float64)
    else:
        return np.float64(raw * signal.int_factor + signal.int_offset)
    if factor == 1.0 and offset == 0.0:
        return code  # keeps the sign of -0.0
    return code * factor + offset


@inline
def unpack(
    data: NDArray[np.uint8],
    frame: int,
    frames: NDArray[Any],
    signals: NDArray[Any],
    values: NDArray[np.float64],
) -> None:
    """Decode `data` (8 bytes) by row `frame` of the tables into the signals' places in `values`."""
    little, big = _little(data), _big(data)
    for row in range(frames[frame].first, frames[frame].end):
        signal = signals[row]
        word = big if signal.big_endian != 0 else little
        raw = (word >> signal.shift) & signal.mask
        raw = (raw ^ signal.sign) - signal.sign
        values[signal.variable] = _unscale(raw, signal)


@inline
def _bits(code: float, kind: int) -> np.int64:
    """Return the int64 that holds this raw value, which lies within the range of its signal."""
    if kind == dbc.FLOAT_32:
        return np.int64(np.float32(code).view(np.int32))
    if kind == dbc.FLOAT_64:
        return np.float64(code).view(np.int64)
    if code >= _TWO_63:
        return np.int64(code - _TWO_63) ^ np.int64(_TOP_BIT)
    return np.int64(code)


@inline
def pack(
    data: NDArray[np.uint8],
    frame: int,
    frames: NDArray[Any],
    signals: NDArray[Any],
    values: NDArray[np.float64],
) -> np.int64:
    """Encode the signals of row `frame` from `values` into `data` (8 bytes, all written).

    Returns how many signals saturated: the nearest raw value lies outside of its limits, or NaN.
    """
    little, big, saturated = np.int64(0), np.int64(0), np.int64(0)
    for row in range(frames[frame].first, frames[frame].end):
        signal = signals[row]
        kind = signal.kind
        is_float = kind == dbc.FLOAT_32 or kind == dbc.FLOAT_64
        low, high = signal.code_low, signal.code_high
        value = values[signal.variable]
        code = (value - signal.offset) / signal.factor
        if not is_float:
            code = _round(code)
        if code != code:
            bits = np.int64(0)
            saturated += 1
        elif code < low:
            bits = _bits(low, kind) if is_float else signal.bits_low
            saturated += 1
        elif code > high:
            bits = _bits(high, kind) if is_float else signal.bits_high
            saturated += 1
        else:
            bits = _bits(code, kind)
        placed = (bits & signal.mask) << signal.shift
        if signal.big_endian != 0:
            big |= placed
        else:
            little |= placed
    for i in range(8):
        byte = (little >> np.int64(8 * i)) | (big >> np.int64(56 - 8 * i))
        data[i] = byte & 255
    return saturated
