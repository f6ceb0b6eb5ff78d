"""The guest's initramfs: busybox, init.sh, guest.sh and the modules, as a cpio archive (newc).

Uncompressed: 4 MB load at once, and inflating them in an emulated processor costs more.
"""

import hashlib
import stat
from pathlib import Path

_HERE = Path(__file__).parent
_FOLDERS = ("bin", "dev", "host", "modules", "proc", "sys")


def contents(busybox: Path, modules: Path) -> dict[str, bytes]:
    """Return the files of the initramfs by path; `modules` holds `order` and the files it names.

    Everything that decides about the guest's start is in here, so its hash is the recipe's.
    """
    order = (modules / "order").read_text(encoding="ascii")
    files = {
        "bin/busybox": busybox.read_bytes(),
        "init": (_HERE / "init.sh").read_bytes(),
        "guest.sh": (_HERE / "guest.sh").read_bytes(),
        "modules/order": order.encode("ascii"),
    }
    files.update({f"modules/{name}": (modules / name).read_bytes() for name in order.split()})
    return files


def recipe_hash(files: dict[str, bytes]) -> str:
    """Return 16 hex digits that change with any name or byte of `files`."""
    digest = hashlib.sha256()
    for name, data in sorted(files.items()):
        digest.update(f"{name}\0{len(data)}\0".encode() + data)
    return digest.hexdigest()[:16]


def archive(files: dict[str, bytes]) -> bytes:
    """Return the cpio archive: all root's, executable, of time 0 (equal in, equal out)."""
    entries = [
        _entry(folder, stat.S_IFDIR | 0o755, b"", 1 + i) for i, folder in enumerate(_FOLDERS)
    ]
    for i, (name, data) in enumerate(sorted(files.items())):
        entries.append(_entry(name, stat.S_IFREG | 0o755, data, 100 + i))
    entries.append(_entry("TRAILER!!!", 0, b"", 0))
    return b"".join(entries)


def _entry(name: str, mode: int, data: bytes, inode: int) -> bytes:
    path = name.encode() + b"\0"
    links = 2 if stat.S_ISDIR(mode) else 1
    fields = (inode, mode, 0, 0, links, 0, len(data), 0, 0, 0, 0, len(path), 0)
    header = b"070701" + b"".join(b"%08X" % field for field in fields)
    return _padded_data(header + path) + _padded_data(data)


def _padded_data(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)
