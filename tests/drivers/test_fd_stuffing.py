"""The bits of CAN FD frames: published CRCs, and a second encoder of strings and long division."""

import itertools
import random
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from test_frame_bits import FD_LENGTHS, fd_bits

from pcpc.drivers.compiled.rows import Flag
from pcpc.drivers.line.fd_stuffing import Place, encode_fd
from pcpc.drivers.line.stuffing import RAW_BITS, WIRE_BITS

DIVISORS = {17: 0x3685B, 21: 0x302899}
COUNTS = ("0000", "0011", "0110", "0101", "1100", "1111", "1010", "1001")  # the standard's table
OTHER = str.maketrans("01", "10")


def fd_frame(
    can_id: int, data: bytes, extended: bool = False, flags: int = Flag.BRS
) -> NDArray[np.uint8]:
    word = can_id | extended << 31
    head = word.to_bytes(4, "little") + bytes([len(data), flags | Flag.FD, 0, 0])
    return np.frombuffer(head + data.ljust(64, b"\0"), np.uint8)


@dataclass(frozen=True)
class Stream:
    """A frame in strings: up to BRS, to the end of the data, from there to the CRC; stuff bits."""

    head: str
    body: str
    check: str
    stuffed: int
    switched: bool

    @property
    def bits(self) -> str:
        return self.body + self.check + "1011111111"

    def ticks(self, bit: int, fast: int) -> list[int]:
        """Return how long each bit lasts; BRS a nominal bit, the CRC delimiter one of the data."""
        data = len(self.body) + len(self.check) + 1 - len(self.head)
        if not self.switched:
            return [bit] * len(self.bits)
        return [bit] * len(self.head) + [fast] * data + [bit] * 9


def with_stuff_bits(bits: str) -> str:
    """Return the bits with the other one behind five equal ones, but not behind the last."""
    begin = 0
    while (found := re.compile("00000|11111").search(bits, begin)) and found.end() < len(bits):
        begin = found.end()
        bits = bits[:begin] + found.group()[0].translate(OTHER) + bits[begin:]
    return bits


def remainder(bits: str, width: int, register: int) -> int:
    """Divide the polynomials; what a register holds at the start is added to the first bits."""
    rest = int(bits, 2) << width ^ register << len(bits)
    while (over := rest.bit_length() - width - 1) >= 0:
        rest ^= DIVISORS[width] << over
    return rest


def stream(can_id: int, data: bytes, extended: bool, flags: int) -> Stream:
    short, brs = f"0{can_id:011b}00", str(int(flags & Flag.BRS != 0))
    long = f"0{can_id >> 18:011b}11{can_id & 0x3FFFF:018b}0"
    head = (long if extended else short) + "10" + brs
    esi = str(int(flags & Flag.ESI != 0))
    raw = head + esi + f"{FD_LENGTHS.index(len(data)):04b}" + "".join(f"{x:08b}" for x in data)
    body, width = with_stuff_bits(raw), 17 if len(data) <= 16 else 21
    stuffed = len(body) - len(raw)
    count = COUNTS[stuffed % 8]
    crc = remainder(body + count, width, 1 << (width - 1))
    check = f"{count}{crc:0{width}b}"
    groups = [check[i : i + 4] for i in range(0, len(check), 4)]
    fixed, last = "", body[-1]
    for group in groups:
        fixed += last.translate(OTHER) + group
        last = group[-1]
    return Stream(with_stuff_bits(head), body, fixed, stuffed, brs == "1")


def encoded(frame: NDArray[np.uint8]) -> tuple[str, Any]:
    wire, places = np.zeros(WIRE_BITS, np.uint8), np.zeros(len(Place), np.int64)
    n = encode_fd(frame, np.zeros(RAW_BITS, np.uint8), wire, places)
    return "".join(map(str, wire[:n])), places


# --------------------------------------------------------------------------------- published values


@pytest.mark.parametrize(("width", "check"), [(17, 0x04F03), (21, 0x0ED841)])
def test_the_polynomials_give_the_check_values_of_the_catalogue(width: int, check: int) -> None:
    """CRC-17/CAN-FD, CRC-21/CAN-FD of reveng.sourceforge.io: "123456789" from register 0."""
    assert remainder("".join(f"{x:08b}" for x in b"123456789"), width, 0) == check


def test_a_frame_has_the_crc_that_a_bus_analyser_shows() -> None:
    """FrameCRC 0x6BD of Vector's CANalyzer (stackoverflow.com, answer 76863615)."""
    bits, places = encoded(fd_frame(0x5AA, b"\xff" * 8))
    check = "".join(b for i, b in enumerate(bits[places[Place.FIXED] : -10]) if i % 5)
    assert check[:4] == COUNTS[12 % 8], "12 stuff bits"
    assert int(check[4:], 2) == 0x6BD


# ------------------------------------------------------------------------- two encoders, bit by bit

PATTERNS = (b"\0", b"\xff", b"\x55", b"\xaa", b"\x0f", b"\xf0", b"\x1f", b"\xe0", b"\x07\xc1\xf0",
            b"\xf8\x3e\x0f", b"\x78", b"\x87\x1e")  # fmt: skip
IDS = {
    False: (0, 0x7FF, 0x5AA, 0x00F, 0x7F0, 0x01F),
    True: (0, 2**29 - 1, 0x15AAAA5, 0x1F, 1 << 20),
}
ENDS = (b"", b"\x1f", b"\xe0", b"\x20", b"\xdf", b"\x3f", b"\xc0")  # runs up to the fixed bits
FLAGS = [brs | esi for brs in (0, Flag.BRS) for esi in (0, Flag.ESI)]


def assert_equal(can_id: int, data: bytes, extended: bool, flags: int) -> Stream:
    expected = stream(can_id, data, extended, flags)
    bits, places = encoded(fd_frame(can_id, data, extended, flags))
    assert bits == expected.bits, f"{can_id:x} {data.hex()} {extended} {flags}"
    begin, end = len(expected.head), len(bits) - 9
    fast = (begin, end) if flags & Flag.BRS else (0, 0)
    assert tuple(places) == (begin - 1, *fast, len(expected.body))
    most = fd_bits(len(data), extended)
    assert len(bits) + 3 <= sum(most)
    assert begin + 9 + 3 <= most[0], "and those of the bit rate before the switch"
    return expected


@pytest.mark.parametrize("extended", [False, True], ids=["11 bit", "29 bit"])
@pytest.mark.parametrize("n", FD_LENGTHS)
def test_two_encoders_make_the_same_bits(n: int, extended: bool) -> None:
    for can_id, pattern, flags in itertools.product(IDS[extended], PATTERNS, FLAGS):
        data = (pattern * 64)[:n]
        for end in ENDS if n else ENDS[:1]:
            assert_equal(can_id, data[: n - len(end)] + end, extended, flags)


def test_random_frames_show_every_kind_of_stuffing_alike() -> None:
    draw = random.Random(1)
    counts, seen = set(), dict.fromkeys(("to the end", "over BRS", "to FDF"), 0)
    for _ in range(3000):
        extended, n = draw.random() < 0.5, draw.choice(FD_LENGTHS)
        can_id = draw.getrandbits(29 if extended else 11) & draw.choice([-1, ~0x1F, ~0x3FFFF])
        kind = draw.choice([[0, 255], [0x1F, 0xE0, 7], range(256)])
        data = bytes(draw.choices(kind, k=n))
        made = assert_equal(can_id, data, extended, draw.choice(FLAGS))
        counts.add(made.stuffed % 8)
        brs = len(made.head) - 1
        seen["to the end"] += made.body[-5:] in ("00000", "11111")
        seen["over BRS"] += made.body[brs - 1 : brs + 4] == "00000"
        seen["to FDF"] += made.head[-9:-3] == "000001"
    assert counts == set(range(8))
    assert min(seen.values()) > 50, f"runs of five: {seen}"


def test_a_length_that_can_fd_has_not_is_padded_to_the_next() -> None:
    frame = fd_frame(0x123, bytes(range(13))).copy()
    padded = fd_frame(0x123, bytes(range(13)).ljust(16, b"\0"))
    assert encoded(frame)[0] == encoded(padded)[0]
    frame[4] = 200
    longest = fd_frame(0x123, bytes(range(13)).ljust(64, b"\0"))
    assert encoded(frame)[0] == encoded(longest)[0]
