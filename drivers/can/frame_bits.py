"""The most bits that a data frame of n bytes can have on the wire, and the time that they take.

    stuffing  behind five equal bits comes one more, the first of the next five at best, so that
              N bits get at most floor((N - 1) / 4) stuff bits                               (1)
    classic   g + 8 n bits from SOF to CRC are stuffed, g = 34, with a 29-bit id 54;
              13 are not: delimiters, ACK, 7 of EOF, 3 of interframe space                   (2)
    FD        h + 8 n bits from SOF to the data are stuffed, h = 22, with a 29-bit id 41; then
              stuff count 4, CRC 17 (21 above 16 bytes), fixed stuff bits 6 (7), and the 13  (3)
    BRS       the first h - 5 bits, their stuff bits and the last 13 are at the nominal bit
              rate, the rest is at that of the data phase. A stuff bit behind the last of the
              h - 5, BRS, is in the data phase                                               (4)

The bit rate changes at the sample points of BRS and CRC delimiter: both count as nominal, though
together they last a bit of each kind. (1) knows no ids, fixed bits and CRCs: the longest real
classic frames are 1 to 3 bits shorter (133 instead of 135 for 8 bytes), as a test finds. Sources:
Davis, Burns, Bril, Lukkien, Controller Area Network (CAN) schedulability analysis: refuted,
revisited and revised, Real-Time Systems 35 (2007), section 2; ISO 11898-1:2015; for (3) also Linux,
include/linux/can/length.h.
"""

import math

from pcpc.drivers.compiled.rows import Flag

UNSTUFFED = 13


def _stuff_bits(bits: int) -> int:
    return (bits - 1) // 4  # (1)


def classic_bits(n: int, extended: bool = False) -> int:
    """Return the bits of a classic frame of `n` bytes, 0 to 8."""
    stuffed = (54 if extended else 34) + 8 * n
    return stuffed + _stuff_bits(stuffed) + UNSTUFFED  # (2)


def fd_bits(n: int, extended: bool = False) -> tuple[int, int]:
    """Return the bits of an FD frame with BRS, at the nominal rate and in the data phase.

    `n` is a length that FD has: 0 to 8, 12, 16, 20, 24, 32, 48, 64.
    """
    begin = 36 if extended else 17
    stuffed = begin + 5 + 8 * n
    checked = 4 + 17 + 6 if n <= 16 else 4 + 21 + 7  # (3)
    nominal = begin + _stuff_bits(begin - 1)  # (4)
    return nominal + UNSTUFFED, stuffed + _stuff_bits(stuffed) + checked - nominal


def frame_bits(n: int, extended: bool, flags: int) -> tuple[int, int]:
    """Return the bits of a frame of these `Flag`, at the nominal rate and in the data phase."""
    if not flags & Flag.FD:
        return classic_bits(min(n, 8), extended), 0
    nominal, data = fd_bits(n, extended)
    return (nominal, data) if flags & Flag.BRS else (nominal + data, 0)


def transmission_ns(n: int, extended: bool, bitrate: float, data_bitrate: float | None) -> int:
    """Return the longest time of a frame, rounded up; FD with BRS if there is a `data_bitrate`."""
    if data_bitrate is None:
        return duration_ns((classic_bits(n, extended), 0), bitrate, bitrate)
    return duration_ns(fd_bits(n, extended), bitrate, data_bitrate)


def duration_ns(bits: tuple[int, int], bitrate: float, data_bitrate: float) -> int:
    """Return the time of so many bits at the nominal rate and in the data phase, rounded up."""
    return math.ceil(1e9 * bits[0] / bitrate + 1e9 * bits[1] / data_bitrate)
