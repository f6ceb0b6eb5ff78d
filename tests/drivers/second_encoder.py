"""A second encoder of frames on the wire, classic and CAN FD: of strings and long division."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.rows import Flag

FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
COUNTS = ("0000", "0011", "0110", "0101", "1100", "1111", "1010", "1001")  # the standard's table
DIVISORS = {15: 0xC599, 17: 0x3685B, 21: 0x302899}
_OTHER = str.maketrans("01", "10")
Bytes = NDArray[np.uint8]


def frame(can_id: int, data: bytes = b"", extended: bool = False) -> Bytes:
    """Return a classic frame."""
    word = can_id | int(extended) << 31
    packed = word.to_bytes(4, "little") + bytes([len(data), 0, 0, 0]) + data.ljust(8, b"\0")
    return np.frombuffer(packed, np.uint8)


def fd_frame(can_id: int, data: bytes, extended: bool = False, flags: int = Flag.BRS) -> Bytes:
    """Return a frame of CAN FD."""
    word = can_id | int(extended) << 31
    head = word.to_bytes(4, "little") + bytes([len(data), flags | Flag.FD, 0, 0])
    return np.frombuffer(head + data.ljust(64, b"\0"), np.uint8)


def parts(one: Bytes) -> tuple[int, bool, bytes]:
    """Return id, whether it is extended, and data of a frame."""
    word = int.from_bytes(one[:4].tobytes(), "little")
    return word & 0x1FFFFFFF, word >> 31 == 1, one[8 : 8 + one[4]].tobytes()


@dataclass(frozen=True)
class Stream:
    """A frame in strings: up to BRS, to the end of the data, from there to the CRC; stuff bits.

    A classic frame has its CRC in `body`, as stuffed as the rest.
    """

    head: str
    body: str
    check: str
    stuffed: int
    switched: bool

    @property
    def bits(self) -> str:
        """SOF to EOF."""
        return self.body + self.check + "1011111111"

    def ticks(self, bit: int, fast: int) -> list[int]:
        """Return how long each bit lasts; BRS a nominal bit, the CRC delimiter one of the data."""
        data = len(self.body) + len(self.check) + 1 - len(self.head)
        if not self.switched:
            return [bit] * len(self.bits)
        return [bit] * len(self.head) + [fast] * data + [bit] * 9


def with_stuff_bits(bits: str, behind_the_last: bool = False) -> str:
    """Return the bits with the other one behind five equal ones."""
    begin = 0
    while (found := re.compile("00000|11111").search(bits, begin)) and (
        found.end() < len(bits) + behind_the_last
    ):
        begin = found.end()
        bits = bits[:begin] + found.group()[0].translate(_OTHER) + bits[begin:]
    return bits


def remainder(bits: str, width: int, register: int = 0) -> int:
    """Divide the polynomials; what a register holds at the start is added to the first bits."""
    rest = int(bits, 2) << width ^ register << len(bits)
    while (over := rest.bit_length() - width - 1) >= 0:
        rest ^= DIVISORS[width] << over
    return rest


def bits_of(data: bytes) -> str:
    """Return bytes in bits."""
    return "".join(f"{byte:08b}" for byte in data)


def arbitration(can_id: int, extended: bool) -> str:
    """Return SOF to IDE, or with a 29-bit id to RTR."""
    if extended:
        return f"0{can_id >> 18:011b}11{can_id & 0x3FFFF:018b}0"
    return f"0{can_id:011b}00"


def stream(one: Bytes) -> Stream:
    """Return the bits of a frame of either kind."""
    can_id, extended, data = parts(one)
    begin = arbitration(can_id, extended)
    if not one[5] & Flag.FD:
        raw = begin + ("00" if extended else "0") + f"{len(data):04b}" + bits_of(data)
        raw += f"{remainder(raw, 15):015b}"
        body = with_stuff_bits(raw, behind_the_last=True)
        return Stream(body, body, "", len(body) - len(raw), False)
    brs, esi = (str(int(one[5] & flag != 0)) for flag in (Flag.BRS, Flag.ESI))
    head = begin + "10" + brs
    raw = head + esi + f"{FD_LENGTHS.index(len(data)):04b}" + bits_of(data)
    body, width = with_stuff_bits(raw), 17 if len(data) <= 16 else 21
    stuffed = len(body) - len(raw)
    count = COUNTS[stuffed % 8]
    check = f"{count}{remainder(body + count, width, 1 << (width - 1)):0{width}b}"
    fixed, last = "", body[-1]
    for group in re.findall("..?.?.?", check):
        fixed += last.translate(_OTHER) + group
        last = group[-1]
    return Stream(with_stuff_bits(head), body, fixed, stuffed, brs == "1")
