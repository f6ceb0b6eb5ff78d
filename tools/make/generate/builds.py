"""The builds in which generated C is checked: how each is compiled and run, and what it needs.

Each prints one line, a digest. What this machine has not is named, with what to install.
"""

import importlib.util
import re
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from pcpc.drivers.errors import UserError
from pcpc.tools.make.generate.device import same_files
from pcpc.tools.make.generate.library import WARNINGS, run
from pcpc.tools.make.generate.translator.elementary import FLAGS

_BARE = (
    "-DBARE", "-mthumb", "-ffreestanding", "-nostdlib", "-fno-tree-loop-distribute-patterns",
    "-T", "mps2.ld", "startup.c",
)  # fmt: skip
_M7 = ("-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-mfloat-abi=hard")
_M4 = (  # libgcc's sum is one bit off now and then
    "-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=softfp",
    "-Wl,--wrap=__aeabi_dadd,--wrap=__aeabi_dsub,--wrap=__aeabi_drsub", "soft_double.c",
)  # fmt: skip
_ALONE = ("startup.c", "soft_double.c")  # of some builds only
_QEMU = (
    "-display", "none", "-serial", "none", "-monitor", "none", "-chardev", "stdio,id=said",
    "-semihosting-config", "enable=on,target=native,chardev=said", "-kernel",
)  # fmt: skip
FIXED = ("codec.c", "codec.h", "startup.c", "soft_double.c", "mps2.ld")
GCC = "apt install gcc"
ZIG = "pip install ziglang, or a zig on the PATH"
ARM = "apt install gcc-arm-none-eabi libnewlib-arm-none-eabi"
QEMU_ARM = "apt install qemu-system-arm"
AARCH64 = "apt install gcc-aarch64-linux-gnu libc6-dev-arm64-cross"
QEMU_USER = "apt install qemu-user-static"
WASMTIME = "pip install wasmtime"


@dataclass(frozen=True)
class Build:
    """One way to compile and run the program `main.c` with the files beside it."""

    name: str
    compiler: tuple[str, ...]  # () if this machine has none
    flags: tuple[str, ...]
    runner: tuple[str, ...] | None  # before the program's path; None: nothing here runs it
    compiler_cure: str
    runner_cure: str = ""
    last: tuple[str, ...] = ()  # behind the sources
    refuses: bool = False  # it would give other bits, and has to say so

    @property
    def possible(self) -> bool:
        """Return whether this machine has what it takes."""
        return bool(self.compiler) and self.runner is not None

    @property
    def cure(self) -> str:
        """Return how to get what this machine lacks."""
        lacks = {self.compiler_cure: not self.compiler, self.runner_cure: self.runner is None}
        return "; ".join(cure for cure, is_missing in lacks.items() if is_missing)

    def digest(self, folder: Path) -> str:
        """Compile and run what lies in the folder; return what was printed. UserError."""
        program = folder / f"{self.name.replace(' ', '_')}.out"
        plain = [file for file in sorted(folder.glob("*.c")) if file.name not in _ALONE]
        flags = [str(folder / one) if one in FIXED else one for one in self.flags]
        run([*self.compiler, *FLAGS, *WARNINGS, *flags, "-o", program, *plain, *self.last])
        assert self.runner is not None
        return run([*self.runner, program]).strip()


def builds() -> list[Build]:
    """Return all builds, in the order of the table."""
    gcc, clang = _installed_program("gcc"), _installed_program("clang")
    arm, machine = _installed_program("arm-none-eabi-gcc"), _installed_program("qemu-system-arm")
    aarch64 = _installed_program("aarch64-linux-gnu-gcc")
    user = _installed_program("qemu-aarch64-static") or _installed_program("qemu-aarch64")
    zig = _zig()
    native = ("-O3", "-march=native")
    return [
        *(Build(f"gcc {level}", gcc, (level,), (), GCC) for level in ("-O0", "-O2", "-O3")),
        Build("gcc -O3 native", gcc, native, (), GCC),
        Build(
            "gcc -O3 native, joining", gcc, (*native, "-ffp-contract=fast"), (), GCC, refuses=True
        ),
        Build("clang -O3 native", clang, native, (), "apt install clang")
        if clang or not zig
        else Build("zig cc -O3 native", (*zig, "cc"), (*native, "-fno-sanitize=all"), (), ZIG),
        Build("AArch64 -O2", aarch64, ("-O2", "-static"), user or None, AARCH64, QEMU_USER),
        Build(
            "Cortex-M7 -O2",
            arm,
            ("-O2", *_BARE, *_M7),
            (*machine, "-M", "mps2-an500", *_QEMU) if machine else None,
            ARM,
            QEMU_ARM,
            ("-lgcc",),
        ),
        Build(
            "Cortex-M4 -O2",
            arm,
            ("-O2", *_BARE, *_M4),
            (*machine, "-M", "mps2-an386", *_QEMU) if machine else None,
            ARM,
            QEMU_ARM,
            ("-lgcc",),
        ),
        Build(
            "wasm32 -O2",
            (*zig, "cc") if zig else (),
            ("-target", "wasm32-wasi", "-O2", "-fno-sanitize=all"),
            _wasmtime(),
            ZIG,
            WASMTIME,
        ),
    ]


def with_runner(build: Build, runner: tuple[str, ...], flags: tuple[str, ...]) -> Build:
    """Return a build that is run in another way, with further flags."""
    return replace(build, runner=runner, flags=(*flags, *build.flags))


def hard_float(build: Build) -> Build:
    """Return a build whose functions take and give numbers in the registers of floats."""
    flags = ("-mfloat-abi=hard" if one == "-mfloat-abi=softfp" else one for one in build.flags)
    return replace(build, flags=tuple(flags))


def fixed_files(folder: Path) -> None:
    """Put the parts that are the same for all rigs into a folder."""
    texts = same_files(fd=False)
    for name in FIXED:
        (folder / name).write_text(texts[name], encoding="utf-8")


class BuildResult(NamedTuple):
    """What became of one build."""

    name: str
    digest: str
    verdict: str

    @property
    def wrong(self) -> bool:
        """Whether it gives other bits, or none."""
        return self.verdict.startswith(("DIFFERS", "FAILS"))

    @property
    def compared(self) -> bool:
        """Whether its bits stood against those of another build."""
        return self.verdict.startswith(("equal", "DIFFERS"))


def table(
    folder: Path,
    own: Sequence[tuple[str, Callable[[], str]]],
    say: Callable[[str], None] = lambda line: None,
) -> tuple[list[BuildResult], list[BuildResult]]:
    """Return what became of those in Python, `own`, and of those in C.

    The first that gives a digest, and need not refuse, is what all others are compared with.
    """
    python, c = list[BuildResult](), list[BuildResult]()
    expected = ""
    for name, work in own:
        say(name)
        python.append(_row(name, work, expected, False))
        expected = expected or python[-1].digest.strip("-")
    for one in builds():
        if one.possible:
            say(one.name)
            c.append(_row(one.name, partial(one.digest, folder), expected, one.refuses))
            expected = expected or c[-1].digest.strip("-")
        else:
            c.append(BuildResult(one.name, "-", f"not here: {one.cure}"))
    return python, c


def _row(name: str, work: Callable[[], str], expected: str, refuses: bool) -> BuildResult:
    """Return what a build gives and what that means, without an expected digest as the first."""
    try:
        digest = work()
    except UserError as error:
        refused = str(error).endswith(": refused")
        verdict = "refused, as it has to be" if refused and refuses else f"FAILS: {error}"
        return BuildResult(name, "-", verdict)
    if not re.fullmatch("[0-9a-f]{16}", digest):
        return BuildResult(name, "-", f"FAILS: no digest, but {digest[:40]!r}")
    if refuses and digest == expected:
        return BuildResult(name, digest, "equal: this processor joins nothing")
    if not expected:
        return BuildResult(name, digest, "what the others are compared with")
    return BuildResult(name, digest, "equal" if digest == expected else "DIFFERS")


def _installed_program(name: str) -> tuple[str, ...]:
    path = shutil.which(name)
    return (path,) if path else ()


def _zig() -> tuple[str, ...]:
    if importlib.util.find_spec("ziglang"):
        return (sys.executable, "-m", "ziglang")
    return _installed_program("zig")


def _wasmtime() -> tuple[str, ...] | None:
    if path := _installed_program("wasmtime"):
        return path
    if importlib.util.find_spec("wasmtime"):
        return (sys.executable, str(Path(__file__).with_name("wasm.py")))
    return None
