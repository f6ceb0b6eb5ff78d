"""A recording as a CANedge leaves it without power: MDF 4.11, not finalised, records unsorted.

Data bytes are of variable length, in records of their own; the counts of records, the length of the
data and of the bytes are still 0.
"""

import struct
from collections.abc import Sequence
from pathlib import Path

START_NS, TICK_S = 1_760_000_000_000_000_000, 50e-6
RECORD = struct.Struct("<QIBBBQ")  # ticks, id, DLC, length, channel and direction, offset of bytes
SUB = {  # bit, byte, bits
    "ID": (0, 8, 29), "IDE": (7, 11, 1), "DLC": (0, 12, 4), "DataLength": (0, 13, 8),
    "BusChannel": (0, 14, 4), "Dir": (4, 14, 1), "DataBytes": (0, 15, 64),
}  # fmt: skip
Frame = tuple[int, int, bool, bool, bytes]  # ticks, id, is extended, is sent, data


class _File:
    def __init__(self) -> None:
        flags = 1 | 1 << 2 | 1 << 5
        head = struct.pack("<8s8s8s4xH30xHH", b"UnFinMF ", b"4.11    ", b"CE      ", 411, flags, 0)
        self.data = bytearray(head)

    def add(self, name: str, links: Sequence[int], body: bytes) -> int:
        """Append a block; return its address."""
        at = len(self.data)
        body += bytes(-len(body) % 8)
        length = 24 + 8 * len(links) + len(body)
        self.data += struct.pack("<4s4xQQ", f"##{name}".encode(), length, len(links))
        self.data += struct.pack(f"<{len(links)}Q", *links) + body
        return at

    def link(self, block: int, number: int, to: int) -> None:
        """Set a link of a block that is there."""
        struct.pack_into("<Q", self.data, block + 24 + 8 * number, to)

    def text(self, text: str) -> int:
        return self.add("TX", [], text.encode() + b"\0")

    def channel(self, name: str, kinds: Sequence[int], place: Sequence[int], *links: int) -> int:
        """Append a channel. `kinds`: of channel, of sync, of data; `links`: next, inside, ..."""
        bit, byte, bits = place
        body = struct.pack("<4B4I2BH6d", *kinds, bit, byte, bits, 1 << 10, 0, 0, 0, 0, *[0.0] * 6)
        following, inside, rule, data = links
        return self.add("CN", [following, inside, self.text(name), 0, rule, data, 0, 0], body)


def write(path: Path, frames: Sequence[Frame]) -> None:
    """Write frames, by time."""
    file = _File()
    first = file.add("HD", [0] * 6, struct.pack("<Q2h4B2d", START_NS, 0, 0, 0, 0, 0, 0, 0.0, 0.0))
    group = file.add("DG", [0] * 4, bytes([1]))
    lengths = file.add("CG", [0] * 6, struct.pack("<2Q2H4x2I", 2, 0, 1, 0, 0, 0))
    source = file.add("SI", [file.text("CAN"), 0, 0], bytes([2, 2, 0]))
    scale = file.add("CC", [0] * 4, struct.pack("<2B3H4d", 1, 0, 0, 0, 2, 0.0, 0.0, 0.0, TICK_S))
    inside = 0
    for name, place in reversed(SUB.items()):
        kinds, data = ((1, 0, 10), lengths) if name == "DataBytes" else ((0, 0, 0), 0)
        inside = file.channel(f"CAN_DataFrame.{name}", kinds, place, inside, 0, 0, data)
    whole = file.channel(
        "CAN_DataFrame", (0, 0, 10), (0, 8, 8 * (RECORD.size - 8)), 0, inside, 0, 0
    )
    master = file.channel("Timestamp", (2, 1, 0), (0, 0, 64), whole, 0, scale, 0)
    about = struct.pack("<2Q2H4x2I", 1, 0, 1 << 1 | 1 << 2, ord("."), RECORD.size, 0)
    bus = file.add("CG", [lengths, master, 0, source, 0, 0], about)
    records, offset = b"", 0
    for ticks, number, extended, sent, data in frames:
        row = ticks, number | extended << 31, len(data), len(data), 1 | sent << 4, offset
        records += b"\x01" + RECORD.pack(*row)
        records += b"\x02" + struct.pack("<I", len(data)) + data
        offset += 4 + len(data)
    file.link(first, 0, group)
    file.link(group, 1, bus)
    file.link(group, 2, file.add("DT", [], b""))
    path.write_bytes(bytes(file.data) + records)
