"""The programs of the host that the virtual machine needs, and the packages that hold them."""

import os
import platform
import shutil
from dataclasses import dataclass
from pathlib import Path

from pcpc.tools.machine.vm.errors import VmError

#: What `make vcan-tools` installs; can-utils and iproute2 are for the commands run in the guest.
APT_PACKAGES = ("qemu-system-x86", "busybox-static", "zstd", "iproute2", "can-utils")

_SYSTEM_FOLDERS = ("/usr/sbin", "/usr/bin", "/sbin", "/bin")


@dataclass(frozen=True)
class Programs:
    """Absolute paths."""

    qemu: str
    busybox: str
    setpriv: str
    apt_get: str
    apt_cache: str
    dpkg_deb: str


_PACKAGE_OF = {
    "qemu": ("qemu-system-x86_64", "qemu-system-x86"),
    "busybox": ("busybox", "busybox-static"),
    "setpriv": ("setpriv", "util-linux"),
    "apt_get": ("apt-get", "apt"),
    "apt_cache": ("apt-cache", "apt"),
    "dpkg_deb": ("dpkg-deb", "dpkg"),
}


def found_programs(search: str | None = None) -> Programs:
    """Return the programs on `search` (default: $PATH and the system's folders).

    Raises VmError that names the packages of all that are missing.
    """
    if platform.machine() != "x86_64":
        raise VmError(f"runs on x86_64 hosts only, this one is {platform.machine()}")
    if search is None:
        search = os.pathsep.join([os.environ.get("PATH", ""), *_SYSTEM_FOLDERS])
    paths = {key: shutil.which(name, path=search) for key, (name, _) in _PACKAGE_OF.items()}
    if paths["busybox"] is not None and not is_static(Path(paths["busybox"])):
        paths["busybox"] = None
    missing = [_PACKAGE_OF[key] for key, path in paths.items() if path is None]
    if "apt" in (package for _, package in missing):
        raise VmError("needs apt to fetch a kernel: Debian, Ubuntu and their relatives only")
    if missing:
        names = ", ".join(name for name, _ in missing)
        packages = " ".join(dict.fromkeys(package for _, package in missing))
        raise VmError(f"missing {names} (packages {packages}); run `make vcan-tools`")
    return Programs(**{key: path for key, path in paths.items() if path is not None})


def is_static(program: Path) -> bool:
    """Say whether an ELF program names no dynamic loader in its first page."""
    with program.open("rb") as file:
        return b"/ld-linux" not in file.read(4096)
