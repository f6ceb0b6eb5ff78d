"""The distribution's own kernel with vcan, fetched by apt and kept in the cache; no root needed.

    <cache>/pcpc/vm/lock                            held while the cache is written
    <cache>/pcpc/vm/<release>/kernel, modules/, package, initramfs-<hash>.img    (about 75 MB)

<cache> is $XDG_CACHE_HOME or ~/.cache. A kernel that is there is used as it is, without asking apt.
Folders and images are built under a temporary name and renamed, so a killed run leaves nothing half
built. Debian: linux-image-amd64; its -cloud- flavour has no CAN. Ubuntu: linux-image-generic, where
vcan is in linux-modules-extra-*.
"""

import fcntl
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pcpc.drivers.compiled.compile_cache import user_cache
from pcpc.tools.machine.vm import initramfs
from pcpc.tools.machine.vm.errors import VmError
from pcpc.tools.machine.vm.programs import Programs
from pcpc.tools.machine.vm.unpack import bootable, module_bytes

_METAPACKAGES = ("linux-image-amd64", "linux-image-generic")
_REQUIRED = ("virtio_pci", "virtio_console", "9pnet_virtio", "9p", "can_raw", "vcan")
_OPTIONAL = ("can_bcm", "can_gw", "can_isotp", "can_j1939", "vxcan")

Say = Callable[[str], None]


@dataclass(frozen=True)
class Kernel:
    """A kernel in the cache, ready to boot."""

    release: str
    image: Path
    initramfs: Path


def cache_folder() -> Path:
    """Return the folder of everything this tool keeps (not created here)."""
    base = user_cache() or Path(tempfile.gettempdir(), f"pcpc-{os.geteuid()}")
    return base / "pcpc" / "vm"


def prepare(programs: Programs, cache: Path, update: bool, say: Say) -> Kernel:
    """Return the newest kernel of the cache, fetching and building what is missing.

    `update` fetches the distribution's present kernel. Raises VmError when apt cannot provide one.
    """
    with _cache_lock(cache, say):
        for leftover in cache.glob("tmp-*"):
            shutil.rmtree(leftover, ignore_errors=True)
        release = None if update else cached_release(cache)
        if release is None:
            release = _fetch(programs, cache, say)
        return _with_initramfs(programs, cache / release)


def cached_release(cache: Path) -> str | None:
    """Return the release of the newest kernel in the cache, None if there is none."""
    releases = [path.parent.name for path in cache.glob("*/kernel")]
    return max(releases, key=_version, default=None)


def packages_to_fetch(programs: Programs) -> tuple[str, list[str]]:
    """Return (release, packages) of the kernel that the distribution's metapackage stands for.

    VmError: apt knows none.
    """
    for metapackage in _METAPACKAGES:
        match = re.search(
            r"^(?:Pre-)?Depends: .*?linux-image-(\d[\w.+~-]*)",
            _apt_show(programs, metapackage),
            re.MULTILINE,
        )
        if match is None:
            continue
        release = match[1]
        modules = (f"linux-modules-{release}", f"linux-modules-extra-{release}")
        known = [name for name in modules if _apt_show(programs, name)]
        return release, [f"linux-image-{release}", *known]
    raise VmError(
        f"apt knows neither {' nor '.join(_METAPACKAGES)}; run `apt-get update` as root, then again"
    )


def load_order(tree: Path, wanted: tuple[str, ...]) -> list[Path]:
    """Return the files of the `wanted` modules and of all they need, in order of loading.

    `tree` is lib/modules/<release>. What is built into the kernel is left out. Raises VmError if
    one is neither there nor built in.
    """
    files = {_module_name(path): path for path in (tree / "kernel").rglob("*.ko*")}
    listing = tree / "modules.builtin"
    builtin = {_module_name(Path(line)) for line in listing.read_text().split()}
    order: list[Path] = []

    def add(name: str) -> None:
        if name in builtin:
            return
        if name not in files:
            raise VmError(f"the kernel {tree.name} has no module {name}")
        if files[name] not in order:
            for other in needed_modules(module_bytes(files[name])):
                add(other)
            order.append(files[name])

    for name in wanted:
        add(name)
    return order


def needed_modules(module: bytes) -> list[str]:
    """Return the names in the `depends=` field of a kernel module (its .modinfo section)."""
    match = re.search(rb"\0depends=([^\0]*)\0", module)
    return match[1].decode().replace("-", "_").split(",") if match and match[1] else []


@contextmanager
def _cache_lock(cache: Path, say: Say) -> Iterator[None]:
    cache.mkdir(parents=True, exist_ok=True)
    with (cache / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("waiting for another one that prepares the kernel")
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _fetch(programs: Programs, cache: Path, say: Say) -> str:
    release, packages = packages_to_fetch(programs)
    with tempfile.TemporaryDirectory(prefix="tmp-", dir=cache) as folder:
        say(f"fetching {' '.join(packages)} with apt ...")
        sandbox = ["-o", "APT::Sandbox::User=root"] if os.geteuid() == 0 else []
        command = [programs.apt_get, *sandbox, "-q", "download", *packages]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            lines = [line for line in done.stderr.splitlines() if line.startswith("E:")]
            why = lines[0] if lines else f"exit code {done.returncode}"
            raise VmError(
                f"apt-get download failed: {why}; run `apt-get update` as root, then again"
            )
        say("unpacking ...")
        root = Path(folder) / "root"
        for package in sorted(Path(folder).glob("*.deb")):
            subprocess.run([programs.dpkg_deb, "-x", package, root], check=True)
        kept = Path(folder) / "kept"
        _keep(root, release, kept)
        (kept / "package").write_text(" ".join(packages) + "\n")
        shutil.rmtree(cache / release, ignore_errors=True)
        kept.rename(cache / release)
    return release


def _keep(root: Path, release: str, kept: Path) -> None:
    trees = [root / prefix / "modules" / release for prefix in ("lib", "usr/lib")]
    tree = next((path for path in trees if (path / "kernel").is_dir()), None)
    images = [*root.glob("boot/vmlinuz-*"), *root.glob("usr/lib/modules/*/vmlinuz")]
    if tree is None or not images:
        raise VmError(f"the packages of {release} hold no vmlinuz or no modules")
    order = load_order(tree, _REQUIRED)
    for name in _OPTIONAL:
        try:
            order += [path for path in load_order(tree, (name,)) if path not in order]
        except VmError:
            continue
    (kept / "modules").mkdir(parents=True)
    (kept / "kernel").write_bytes(bootable(images[0].read_bytes()))
    for path in order:
        (kept / "modules" / f"{_module_name(path)}.ko").write_bytes(module_bytes(path))
    names = "\n".join(f"{_module_name(path)}.ko" for path in order)
    (kept / "modules" / "order").write_text(names + "\n", encoding="ascii")


def _with_initramfs(programs: Programs, folder: Path) -> Kernel:
    files = initramfs.contents(Path(programs.busybox), folder / "modules")
    image = folder / f"initramfs-{initramfs.recipe_hash(files)}.img"
    if not image.exists():
        for old in folder.glob("initramfs-*"):
            old.unlink()
        new = image.with_suffix(".new")
        new.write_bytes(initramfs.archive(files))
        new.replace(image)
    return Kernel(folder.name, folder / "kernel", image)


def _apt_show(programs: Programs, package: str) -> str:
    """Return what apt tells of a package, "" where it does not know it."""
    command = [programs.apt_cache, "show", "--no-all-versions", package]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    return "" if found.returncode else found.stdout


def _module_name(path: Path) -> str:
    return path.name.split(".ko")[0].replace("-", "_")


def _version(release: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", release)]
