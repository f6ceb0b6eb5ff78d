"""The C compiler of this machine, for yardsticks in C."""

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError


class BenchError(UserError):
    """The yardstick is missing."""

    code = Exit.ENVIRONMENT


class CompilerError(BenchError):
    """There is no C compiler, or it refuses a source."""


def find() -> str:
    """Return the path of the C compiler; CompilerError."""
    for name in ("cc", "gcc", "clang"):
        if path := shutil.which(name):
            return path
    raise CompilerError("cc: no C compiler on PATH; `apt-get install gcc` brings one")


def compile_to(out: Path, sources: Sequence[Path], flags: Sequence[str]) -> None:
    """Compile `sources` to the file `out`; CompilerError.

    It is compiled under another name first: a reader never sees half a file.
    """
    compiler, part = find(), out.with_suffix(f".{os.getpid()}")
    command = [compiler, "-std=gnu11", *flags, "-o", str(part), *map(str, sources), "-lm"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        first = next((line for line in result.stderr.splitlines() if "error" in line), "no message")
        names = ", ".join(source.name for source in sources)
        raise CompilerError(f"{compiler} cannot compile {names}: {first}")
    part.replace(out)
