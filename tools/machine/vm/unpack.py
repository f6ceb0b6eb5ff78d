"""What the distribution compressed: kernel modules, and the kernel inside its boot image.

An emulated processor inflates a Debian kernel in 7 s; QEMU boots the inflated ELF file directly
where it has the PVH entry point (Xen's boot protocol, in the kernels of Debian and Ubuntu).
"""

import lzma
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

from pcpc.tools.machine.vm.errors import VmError

_SETUP_SECTORS_AT, _MAGIC_AT, _PAYLOAD_AT = (
    0x1F1,
    0x202,
    0x248,
)  # Linux: Documentation/arch/x86/boot.rst
_SECTOR_BYTES, _SIZE_BYTES = 512, 4  # the payload ends with its inflated size
_PVH_NOTE = struct.pack("<I4s", 18, b"Xen")  # XEN_ELFNOTE_PHYS32_ENTRY


def decompress(data: bytes) -> bytes:
    """Return `data` inflated if it begins as xz, gzip or zstd, else as it is.

    Raises VmError if it takes the program zstd and there is none.
    """
    if data.startswith(b"\xfd7zXZ\0"):
        return lzma.LZMADecompressor().decompress(data)
    if data.startswith(b"\x1f\x8b"):
        return zlib.decompressobj(wbits=31).decompress(data)
    if data.startswith(b"\x28\xb5\x2f\xfd"):
        zstd = shutil.which("zstd")
        if zstd is None:
            raise VmError(
                "missing zstd, for this kernel's modules (package zstd); run `make vcan-tools`"
            )
        return subprocess.run([zstd, "-dcq"], input=data, stdout=subprocess.PIPE, check=True).stdout
    return data


def module_bytes(path: Path) -> bytes:
    """Return the bytes of a kernel module, decompressed: .ko, .ko.xz or .ko.zst."""
    return decompress(path.read_bytes())


def bootable(image: bytes) -> bytes:
    """Return the ELF file inside a bzImage if QEMU can boot it, else `image` unchanged."""
    if image[_MAGIC_AT : _MAGIC_AT + 4] != b"HdrS":
        return image
    offset, length = struct.unpack_from("<II", image, _PAYLOAD_AT)
    start = (image[_SETUP_SECTORS_AT] + 1) * _SECTOR_BYTES + offset
    kernel = decompress(image[start : start + length - _SIZE_BYTES])
    return kernel if kernel.startswith(b"\x7fELF") and _PVH_NOTE in kernel else image
