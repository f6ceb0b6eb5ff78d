"""The C side of the benchmarks: sources as a library, kept in the cache folder, and its headers.

A numpy record type becomes a struct with the same layout, checked by the compiler; the constants of
a Python module become macros. So C works on the very memory of the compiled loop.
"""

import ctypes
import hashlib
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np

from pcpc.drivers.compile_cache import made
from pcpc.tools.machine.jitter.compiler import compile_to, find

C_NAMES = {"errno": "errno_"}  # a macro of C
C_TYPES = {"<i8": "int64_t", "<f8": "double", "|u1": "uint8_t"}


def library(
    sources: Sequence[Path], flags: Sequence[str], headers: Mapping[str, str]
) -> ctypes.CDLL:
    """Return a library of `sources`, compiled if the cache has none; CompilerError.

    `headers` are the texts of made header files, by name. What a source includes from its own
    folder must be among `sources` or have a text in `headers`.
    """
    version = subprocess.run([find(), "--version"], capture_output=True, check=False).stdout
    parts = [*(source.read_bytes() for source in sources), " ".join(flags).encode(), version]
    parts += [text.encode() for text in headers.values()]
    digest = hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]
    folder = made(f"bench-{digest}")
    path = folder / f"{sources[0].stem}.so"
    if not path.exists():
        for name, text in headers.items():
            (folder / name).write_text(text, encoding="utf-8")
        compile_to(path, sources, [*flags, "-shared", "-fPIC", f"-I{folder}"])
    return ctypes.CDLL(str(path))


def struct(name: str, dtype: np.dtype) -> str:
    """Return `struct name` for a record type; a field of record type F is a `struct F`."""
    assert dtype.fields is not None, f"{dtype} is no record type"
    lines, checks = [], []
    for field, (kind, offset, *_) in dtype.fields.items():
        named = C_NAMES.get(field, field)
        base, shape = kind.subdtype or (kind, ())
        text = f"struct {field}" if base.fields else C_TYPES[base.str]
        lines.append(f"    {text} {named}{''.join(f'[{n}]' for n in shape)};")
        checks.append(f"offsetof(struct {name}, {named}) == {offset}")
    checks.append(f"sizeof(struct {name}) == {dtype.itemsize}")
    asserts = [f'_Static_assert({check}, "struct {name}");' for check in checks]
    return "\n".join([f"struct {name} {{", *lines, "};", *asserts, ""])


def macros(prefix: str, module: ModuleType) -> str:
    """Return `#define PREFIX_NAME value` for each whole number in capitals of `module`."""
    found = {k: v for k, v in vars(module).items() if k.isupper() and type(v) is int}
    return "".join(f"#define {prefix}_{k} {v}LL\n" for k, v in found.items() if k[0] != "_")


def array(name: str, c_type: str, values: np.ndarray) -> str:
    """Return a constant C array with the shape and the values of `values`."""
    places = "".join(f"[{n}]" for n in values.shape)
    flat = ", ".join(str(value) for value in values.ravel().tolist())
    return f"static const {c_type} {name}{places} = {{{flat}}};\n"
