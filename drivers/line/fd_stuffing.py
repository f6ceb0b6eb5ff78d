"""The bits of one CAN FD frame on the wire, one by one: stuff count, CRC, fixed stuff bits.

    SOF, id, RRS, IDE, FDF 1, res 0, BRS, ESI, DLC, data    behind five equal bits comes one of the
                                                            other kind, but not behind the last (1)
    stuff count, CRC     before each four bits, and so before the first, comes the opposite of the
                         bit before it                                                          (2)
    CRC delimiter, ACK slot and delimiter, 7 EOF                                    not stuffed

The stuff count is that of (1) modulo 8, in Gray code with a bit of even parity. The CRC is over all
bits before it but those of (2); up to 16 bytes have CRC-17, more have CRC-21. Its register starts
with a 1 at the top. Source: ISO 11898-1:2015, 10.4.2, 10.5.
"""

import numpy as np

from pcpc.drivers.can.wire_layout import LENGTHS
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import FLAGS, LENGTH, Flag
from pcpc.drivers.line.stuffing import END_BITS, append, append_id

_POLYNOMIAL_17, _POLYNOMIAL_21 = 0x1685B, 0x102899
_SHORT_CRC_BYTES = 16
_LENGTHS = np.array(LENGTHS)
_GROUP = 4  # bits behind a fixed stuff bit
FIXED_EVERY = _GROUP + 1


class Place(NumberedEnum):
    """Bits of a frame: BRS, first of the data phase, first behind it, first fixed stuff bit."""

    BRS, FAST, FAST_END, FIXED = range(4)


@loop_function
def _head(frame: Cells[Byte], raw: Cells[Byte], code: int) -> int:
    """Write SOF to DLC of `frame` (72,); return the number of bits."""
    n = append(raw, append_id(frame, raw), 2, 2)  # FDF, res
    n = append(raw, n, int64((frame[FLAGS] & Flag.BRS) != 0), 1)
    n = append(raw, n, int64((frame[FLAGS] & Flag.ESI) != 0), 1)
    return append(raw, n, code, 4)


@loop_function
def _crc(crc: int, bits: Cells[Byte], n: int, width: int) -> int:
    """Return the register after `n` more bits."""
    polynomial = _POLYNOMIAL_17 if width == 17 else _POLYNOMIAL_21
    for i in range(n):
        feedback = (crc >> (width - 1)) ^ int64(bits[i])
        crc = (crc << 1) & ((1 << width) - 1)
        if feedback != 0:
            crc ^= polynomial
    return crc


@loop_function
def encode_fd(frame: Cells[Byte], raw: Cells[Byte], wire: Cells[Byte], places: Cells[int]) -> int:
    """Write the bits of `frame` (72,) to `wire`, SOF to EOF; return how many. `raw` is scratch.

    `places` (4,) gets those of `Place`; without a bit rate switch the data phase is empty. BRS
    counts as nominal and the CRC delimiter as of the data phase: together they last a bit of each,
    wherever in them the sample points are, at which the rate changes.
    """
    code = int64(0)
    while code < len(_LENGTHS) - 1 and _LENGTHS[code] < frame[LENGTH]:
        code += 1
    n = _head(frame, raw, code)
    brs = n - 6
    for i in range(_LENGTHS[code]):
        n = append(raw, n, int64(frame[8 + i]), 8)
    out, run, stuffed = int64(0), int64(0), int64(0)
    for i in range(n):
        run = run + 1 if out > 0 and wire[out - 1] == raw[i] else int64(1)
        wire[out] = raw[i]
        if i == brs:
            places[Place.BRS] = out
        out += 1
        if run == 5 and i < n - 1:  # (1)
            wire[out] = 1 - raw[i]
            out += 1
            stuffed += 1
            run = int64(1)
    places[Place.FIXED] = out
    n = _append_check(raw, wire, out, stuffed, 17 if _LENGTHS[code] <= _SHORT_CRC_BYTES else 21)
    switched = frame[FLAGS] & Flag.BRS != 0
    places[Place.FAST] = places[Place.BRS] + 1 if switched else int64(0)
    places[Place.FAST_END] = n + 1 if switched else int64(0)
    return append(wire, n, 0x2FF, END_BITS)  # 1 0 1 1111111


@loop_function
def _append_check(raw: Cells[Byte], wire: Cells[Byte], out: int, stuffed: int, width: int) -> int:
    """Write stuff count and CRC behind `out` bits, of which `stuffed` are stuff bits (2)."""
    gray = stuffed % 8 ^ stuffed % 8 >> 1
    count = gray << 1 | (gray ^ gray >> 1 ^ gray >> 2) & 1
    append(raw, 0, count, 4)
    crc = _crc(int64(1) << (width - 1), wire, out, width)
    append(raw, 4, _crc(crc, raw, 4, width), width)
    for i in range(4 + width):
        if i % _GROUP == 0:
            wire[out] = 1 - wire[out - 1]
            out += 1
        wire[out] = raw[i]
        out += 1
    return out
