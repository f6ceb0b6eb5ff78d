"""The bits of one classic data frame on the wire, one by one: CRC-15, stuff bits, fixed end.

    SOF, id, RTR, IDE, r0, DLC, data, CRC     behind five equal bits comes one of the other kind
    CRC delimiter, ACK slot and delimiter, 7 EOF                              not stuffed

0 is dominant. The ACK slot is dominant, as receivers make it. The interframe space is not part of
it. `drivers.can.frame_bits` has the longest that such a frame can be, `drivers.line.fd_stuffing`
those of CAN FD. Source: ISO 11898-1:2015, 10.4.
"""

from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import LENGTH

RAW_BITS = 560  # SOF to CRC: 118 with a 29-bit id; FD to the data: 553
WIRE_BITS = 736  # with stuff bits and the end: 157 at most; FD: 733
SHORT_ID_BITS = 14  # SOF to IDE
END_BITS = 10  # CRC delimiter to EOF
EOF_BITS, INTERMISSION_BITS = 7, 3
_POLYNOMIAL = 0x4599


@loop_function
def append(bits: Cells[Byte], n: int, value: int, count: int) -> int:
    """Write the lowest `count` bits of `value` from place `n` on; return where they end."""
    for i in range(count):
        bits[n + i] = (value >> (count - 1 - i)) & 1
    return n + count


@loop_function
def append_id(frame: Cells[Byte], raw: Cells[Byte]) -> int:
    """Write SOF to IDE, of a 29-bit id to RTR, of `frame`; return the number of bits, 14 or 33."""
    word = int64(0)
    for i in range(4):
        word |= int64(frame[i]) << (8 * i)
    raw[0] = 0
    if word >> 31 != 0:
        n = append(raw, 1, (word >> 18) & 0x7FF, 11)
        n = append(raw, n, 3, 2)  # SRR, IDE
        n = append(raw, n, word & 0x3FFFF, 18)
        return append(raw, n, 0, 1)  # RTR
    n = append(raw, 1, word & 0x7FF, 11)
    return append(raw, n, 0, 2)  # RTR, IDE


@loop_function
def _crc15(raw: Cells[Byte], n: int) -> int:
    crc = int64(0)
    for i in range(n):
        feedback = (crc >> 14) ^ int64(raw[i])
        crc = (crc << 1) & 0x7FFF
        if feedback != 0:
            crc ^= _POLYNOMIAL
    return crc


@loop_function
def encode(frame: Cells[Byte], raw: Cells[Byte], wire: Cells[Byte]) -> int:
    """Write the bits of `frame` (16,) to `wire`, SOF to EOF; return how many. `raw` is scratch."""
    n = append_id(frame, raw)
    n = append(raw, n, 0, 1 if n == SHORT_ID_BITS else 2)  # r0, with a 29-bit id r1 before it
    n = append(raw, n, int64(frame[LENGTH]), 4)
    for i in range(min(int64(frame[LENGTH]), int64(8))):
        n = append(raw, n, int64(frame[8 + i]), 8)
    n = append(raw, n, _crc15(raw, n), 15)
    out, run = int64(0), int64(0)
    for i in range(n):
        run = run + 1 if out > 0 and wire[out - 1] == raw[i] else int64(1)
        wire[out] = raw[i]
        out += 1
        if run == 5:
            wire[out] = 1 - raw[i]
            out += 1
            run = int64(1)
    return append(wire, out, 0x2FF, END_BITS)  # 1 0 1 1111111
