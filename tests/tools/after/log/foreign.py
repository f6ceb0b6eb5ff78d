"""Small recordings as other tools write them, made of the same frames."""

import base64
import random
import sqlite3
import struct
import tempfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

START_S = 1_700_000_000
LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
LOBJ = struct.Struct("<4sHHLL")  # mark, size of the head, its version, size, kind


class Sent(NamedTuple):
    """A frame that was recorded, `us` after the start."""

    us: int
    number: int
    extended: bool
    data: bytes
    fd: bool = False
    received: bool = True

    @property
    def id(self) -> str:
        """Return the id as candump writes it."""
        return f"{self.number:08X}" if self.extended else f"{self.number:03X}"

    @property
    def spaced(self) -> str:
        """Return the data in hexadecimal with blanks."""
        return self.data.hex(" ").upper()


def some_frames(seed: int, count: int = 6, fd: bool = True) -> list[Sent]:
    """Return frames of many kinds."""
    dice, frames = random.Random(seed), []
    for i in range(count):
        extended, is_fd = dice.random() < 0.4, fd and dice.random() < 0.4
        number = dice.randrange(1 << 29) if extended else dice.randrange(1 << 11)
        size = dice.choice(LENGTHS if is_fd else LENGTHS[:9])
        received = dice.random() < 0.7
        frames.append(Sent(10_000 * i, number, extended, dice.randbytes(size), is_fd, received))
    return frames


def candump(frames: Sequence[Sent]) -> bytes:
    """Write a log as `candump -L` does."""
    lines = []
    for f in frames:
        mark = "##0" if f.fd else "#"
        at = f"({START_S + f.us // 10**6}.{f.us % 10**6:06d})"
        lines.append(f"{at} can0 {f.id}{mark}{f.data.hex().upper()} {'TR'[f.received]}\n")
    return "".join(lines).encode()


def screen(frames: Sequence[Sent]) -> bytes:
    """Write what `candump -ta -x` shows."""
    lines = []
    for f in frames:
        size = f"[{len(f.data):02d}]" if f.fd else f" [{len(f.data)}]"
        at = f" ({START_S + f.us // 10**6}.{f.us % 10**6:06d})"
        way = "RX" if f.received else "TX"
        lines.append(f"{at}  can0  {way} - -  {f.id}  {size}  {f.spaced}\n")
    return "".join(lines).encode()


def asc(frames: Sequence[Sent]) -> bytes:
    """Write a log as Vector's tools do."""
    lines = ["date 2023-11-14 22:13:20.000", "base hex  timestamps absolute"]
    lines += ["internal events logged", "Begin TriggerBlock", "   0.000000 Start of measurement"]
    for f in frames:
        at, way = f"{f.us / 1e6:11.6f}", "Rx" if f.received else "Tx"
        number = f"{f.number:X}{'x' if f.extended else ''}"
        if f.fd:
            dlc = f"{LENGTHS.index(len(f.data)):x} {len(f.data):2d}"
            lines.append(f"{at} CANFD   1 {way} {number}  0 0 {dlc} {f.spaced} 0 0 1000 0 0 0 0 0")
        else:
            lines.append(f"{at} 1  {number} {way}   d {len(f.data)} {f.spaced}")
    return "\r\n".join([*lines, "End TriggerBlock", ""]).encode()


def trc1(frames: Sequence[Sent]) -> bytes:
    """Write TRC 1.1, of classic frames."""
    lines = [";$FILEVERSION=1.1", ";$STARTTIME=45244.92592592592592593", ";"]
    for i, f in enumerate(frames, 1):
        number, way = f"{f.number:0{8 if f.extended else 4}X}", "Rx" if f.received else "Tx"
        lines.append(f"{i:6d}) {f.us / 1e3:11.1f}  {way} {number:>12}  {len(f.data)}  {f.spaced}")
    return "\r\n".join([*lines, ""]).encode()


def trc2(frames: Sequence[Sent]) -> bytes:
    """Write TRC 2.1."""
    lines = [";$FILEVERSION=2.1", ";$STARTTIME=45244.92592592592592593"]
    lines += [";$COLUMNS=N,O,T,B,I,d,R,L,D", ";"]
    for i, f in enumerate(frames, 1):
        number, way = f"{f.number:0{8 if f.extended else 4}X}", "Rx" if f.received else "Tx"
        kind, dlc = "FD" if f.fd else "DT", LENGTHS.index(len(f.data))
        lines.append(f"{i:7d} {f.us / 1e3:13.3f} {kind} 1 {number:>9} {way} - {dlc:2d}  {f.spaced}")
    return "\r\n".join([*lines, ""]).encode()


def can_csv(frames: Sequence[Sent]) -> bytes:
    """Write python-can's CSV, of classic frames that were received."""
    lines = ["timestamp,arbitration_id,extended,remote,error,dlc,data"]
    for f in frames:
        data = base64.b64encode(f.data).decode()
        at = f"{START_S + f.us // 10**6}.{f.us % 10**6:06d}"
        lines.append(f"{at},{f.number:#x},{int(f.extended)},0,0,{len(f.data)},{data}")
    return "\n".join([*lines, ""]).encode()


def blf_object(kind: int, body: bytes, at_us: int = 0, version: int = 1) -> bytes:
    """Return an object of a BLF file."""
    head = struct.pack("<LHHQ", 2, 0, 0, at_us * 1000)
    size = LOBJ.size + len(head) + len(body)
    return LOBJ.pack(b"LOBJ", 32, version, size, kind) + head + body + bytes(size % 4)


def blf_frame(f: Sent) -> bytes:
    """Return the object of a frame."""
    word = f.number | f.extended << 31
    if f.fd:
        dlc, size = LENGTHS.index(len(f.data)), len(f.data)
        numbers = (1, dlc, size, 0, word, 0, 0x1000, 0, 0, 0, 0, 0, int(not f.received), 0, 0)
        return blf_object(101, struct.pack("<BBBBLLLLLLLHBBL", *numbers) + f.data, f.us)
    body = struct.pack("<HBBL8s", 1, int(not f.received), len(f.data), word, f.data)
    return blf_object(1, body, f.us)


def blf_container(data: bytes, method: int = 2) -> bytes:
    """Return a container of objects, packed with zlib if `method` is 2."""
    packed = zlib.compress(data) if method == 2 else data
    body = struct.pack("<H6xL4x", method, len(data)) + packed
    return LOBJ.pack(b"LOBJ", 16, 1, 16 + len(body), 10) + body + bytes((16 + len(body)) % 4)


def blf_file(parts: Sequence[bytes], objects: int, size: int | None = None) -> bytes:
    """Return a BLF file of containers; `size` as its head says it."""
    content = b"".join(parts)
    whole = 144 + len(content) if size is None else size
    head = struct.pack("<4sL8xQQLL8H", b"LOGG", 144, whole, whole, objects, 0,
                       2023, 11, 2, 14, 22, 13, 20, 0)  # fmt: skip
    return head.ljust(144, b"\0") + content


def blf(frames: Sequence[Sent]) -> bytes:
    """Write BLF with a container for every 13 words of objects, so that they go on in the next."""
    data = b"".join(map(blf_frame, frames))
    parts = [blf_container(data[i : i + 52]) for i in range(0, len(data), 52)]
    return blf_file(parts, len(frames))


def database(frames: Sequence[Sent]) -> bytes:
    """Write python-can's SQLite file, of classic frames that were received."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.db"
        table = sqlite3.connect(path)
        table.execute(
            "CREATE TABLE messages (ts REAL, arbitration_id INTEGER, extended INTEGER, "
            "remote INTEGER, error INTEGER, dlc INTEGER, data BLOB)"
        )
        for f in frames:
            row = (START_S + f.us / 1e6, f.number, f.extended, 0, 0, len(f.data), f.data)
            table.execute("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)", row)
        table.commit()
        table.close()
        return path.read_bytes()


WRITERS: dict[str, tuple[str, Callable[[Sequence[Sent]], bytes], bool, bool]] = {
    # name: suffix, writer, has CAN FD, says what was received
    "candump": (".log", candump, True, True),
    "screen": (".log", screen, True, True),
    "asc": (".asc", asc, True, True),
    "trc1": (".trc", trc1, False, True),
    "trc2": (".trc", trc2, True, True),
    "csv": (".csv", can_csv, False, False),
    "blf": (".blf", blf, True, True),
    "db": (".db", database, False, False),
}
TEXTS = ("candump", "screen", "asc", "trc1", "trc2", "csv")
