"""The bits of frames, classic and CAN FD: published CRCs, and those of the second encoder."""

import itertools
import random
import re
from typing import Any

import numpy as np
import pytest
from second_encoder import (
    COUNTS,
    FD_LENGTHS,
    Bytes,
    Stream,
    bits_of,
    fd_frame,
    frame,
    remainder,
    stream,
)  # fmt: skip

from pcpc.drivers.can.frame_bits import classic_bits, fd_bits
from pcpc.drivers.compiled.rows import Flag
from pcpc.drivers.line.fd_stuffing import Place, encode_fd
from pcpc.drivers.line.stuffing import RAW_BITS, WIRE_BITS, encode


def encoded(one: Bytes) -> tuple[str, Any]:
    """Return the bits of a frame, of CAN FD with the places in them."""
    raw, wire = np.zeros(RAW_BITS, np.uint8), np.zeros(WIRE_BITS, np.uint8)
    places = np.zeros(len(Place), np.int64)
    n = encode_fd(one, raw, wire, places) if one[5] & Flag.FD else encode(one, raw, wire)
    return "".join(map(str, wire[:n])), places


# --------------------------------------------------------------------------------- published values


@pytest.mark.parametrize(("width", "check"), [(15, 0x059E), (17, 0x04F03), (21, 0x0ED841)])
def test_the_polynomials_give_the_check_values_of_the_catalogue(width: int, check: int) -> None:
    """CRC-15/CAN, CRC-17/CAN-FD, CRC-21/CAN-FD of reveng.sourceforge.io: "123456789"."""
    assert remainder(bits_of(b"123456789"), width) == check


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
FLAGS = {"classic": [0], "fd": [Flag.FD | a | b for a in (0, Flag.BRS) for b in (0, Flag.ESI)]}
LENGTHS = {"classic": FD_LENGTHS[:9], "fd": FD_LENGTHS}
ENDS_IN = {"classic": "(000001|111110)$", "fd": "(00000|11111)$"}  # a stuff bit behind the CRC


def assert_equal(can_id: int, data: bytes, extended: bool, flags: int) -> Stream:
    made = fd_frame(can_id, data, extended, flags) if flags else frame(can_id, data, extended)
    expected, (bits, places) = stream(made), encoded(made)
    assert bits == expected.bits, f"{can_id:x} {data.hex()} {extended} {flags}"
    if not flags:
        assert len(bits) + 3 <= classic_bits(len(data), extended)
        return expected
    begin, end = len(expected.head), len(bits) - 9
    fast = (begin, end) if flags & Flag.BRS else (0, 0)
    assert tuple(places) == (begin - 1, *fast, len(expected.body))
    most = fd_bits(len(data), extended)
    assert len(bits) + 3 <= sum(most)
    assert begin + 9 + 3 <= most[0], "and those of the bit rate before the switch"
    return expected


@pytest.mark.parametrize("extended", [False, True], ids=["11 bit", "29 bit"])
@pytest.mark.parametrize(("kind", "n"), [(kind, n) for kind in FLAGS for n in LENGTHS[kind]])
def test_two_encoders_make_the_same_bits(kind: str, n: int, extended: bool) -> None:
    for can_id, pattern, flags in itertools.product(IDS[extended], PATTERNS, FLAGS[kind]):
        data = (pattern * 64)[:n]
        for end in ENDS if n else ENDS[:1]:
            assert_equal(can_id, data[: n - len(end)] + end, extended, flags)


@pytest.mark.parametrize("kind", FLAGS)
def test_random_frames_show_every_kind_of_stuffing_alike(kind: str) -> None:
    draw = random.Random(1)
    counts, seen = set(), dict.fromkeys(("to the end", "over BRS", "to FDF"), 0)
    for _ in range(3000):
        extended, n = draw.random() < 0.5, draw.choice(LENGTHS[kind])
        can_id = draw.getrandbits(29 if extended else 11) & draw.choice([-1, ~0x1F, ~0x3FFFF])
        bytes_of = draw.choice([[0, 255], [0x1F, 0xE0, 7], [0x78, 0x87, 0x0F, 0xC3], range(256)])
        made = assert_equal(
            can_id, bytes(draw.choices(bytes_of, k=n)), extended, draw.choice(FLAGS[kind])
        )
        counts.add(made.stuffed % 8)
        seen["to the end"] += re.search(ENDS_IN[kind], made.body) is not None
        brs = len(made.head) - 1
        seen["over BRS"] += made.body[brs - 1 : brs + 4] == "00000"
        seen["to FDF"] += made.head[-9:-3] == "000001"
    assert counts == set(range(8))
    least = seen["to the end"] if kind == "classic" else min(seen.values())
    assert least > 50, f"runs of five: {seen}"


def test_a_length_that_can_fd_has_not_is_padded_to_the_next() -> None:
    made = fd_frame(0x123, bytes(range(13))).copy()
    padded = fd_frame(0x123, bytes(range(13)).ljust(16, b"\0"))
    assert encoded(made)[0] == encoded(padded)[0]
    made[4] = 200
    longest = fd_frame(0x123, bytes(range(13)).ljust(64, b"\0"))
    assert encoded(made)[0] == encoded(longest)[0]
