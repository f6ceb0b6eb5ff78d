"""The C side of the bench: generated C and frame.c, headers, compilation.

A numpy record type becomes a struct with the same layout, checked by the compiler; the constants of
a Python module become macros. So C works on the very memory of the compiled loop. All of it is
compiled with -O2 -ffp-contract=off, which gives the bits of Python. The cache folder keeps the
libraries.
"""

import ctypes
import hashlib
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.compile_cache import writable_folder
from pcpc.drivers.compiled.numbered import NumberedKind
from pcpc.tools.machine.jitter.compiler import compile_to, find

FLAGS = ("-O2", "-ffp-contract=off", "-shared", "-fPIC")
C_NAMES = {"errno": "errno_"}  # a macro of C
C_TYPES = {"<i8": "int64_t", "<f8": "double", "|u1": "uint8_t"}


def library(sources: Sequence[Path], texts: Mapping[str, str]) -> ctypes.CDLL:
    """Return a library of `sources`, compiled if the cache has none; CompilerError.

    `texts`: headers, and what else is compiled, by file name.
    """
    version = subprocess.run([find(), "--version"], capture_output=True, check=False).stdout
    parts = [*(source.read_bytes() for source in sources), " ".join(FLAGS).encode(), version]
    parts += [text.encode() for text in texts.values()]
    digest = hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]
    folder = writable_folder(f"bench-{digest}")
    path = folder / f"{sources[0].stem}.so"
    if not path.exists():
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        every = [*sources, *(folder / name for name in texts if name.endswith(".c"))]
        compile_to(path, every, [*FLAGS, f"-I{folder}"])
    return ctypes.CDLL(str(path))


def address(array: NDArray[Any] | np.record) -> ctypes.c_void_p:
    """Return the address of a record, or of an array's first element."""
    return ctypes.c_void_p(np.asarray(array).ctypes.data)


def struct(name: str, dtype: np.dtype) -> str:
    """Return `struct name` for a record type; a field of record type F is a `struct F`."""
    assert dtype.fields is not None, f"{dtype} is no record type"
    lines, checks, end = [], [], 0
    for field, (kind, offset, *_) in dtype.fields.items():
        if offset > end:
            lines.append(f"    char before_{field}[{offset - end}];")
        end = offset + kind.itemsize
        named = C_NAMES.get(field, field)
        base, shape = kind.subdtype or (kind, ())
        text = f"struct {field}" if base.fields else C_TYPES[base.str]
        lines.append(f"    {text} {named}{''.join(f'[{n}]' for n in shape)};")
        checks.append(f"offsetof(struct {name}, {named}) == {offset}")
    if dtype.itemsize > end:
        lines.append(f"    char rest[{dtype.itemsize - end}];")
    checks.append(f"sizeof(struct {name}) == {dtype.itemsize}")
    asserts = [f'_Static_assert({check}, "struct {name}");' for check in checks]
    return "\n".join([f"struct {name} {{", *lines, "};", *asserts, ""])


def macros(prefix: str, module: ModuleType) -> str:
    """Return `#define PREFIX_NAME value` for each whole number in capitals of `module`."""
    found = {k: v for k, v in vars(module).items() if k.isupper() and type(v) is int}
    return "".join(f"#define {prefix}_{k} {v}LL\n" for k, v in found.items() if k[0] != "_")


def numbers(kind: NumberedKind) -> str:
    """Return `#define KIND_NAME number` for each member of a declaration."""
    every: Any = kind
    return "".join(f"#define {kind.__name__.upper()}_{one.name} {one}LL\n" for one in every)


def array(name: str, c_type: str, values: np.ndarray) -> str:
    """Return a constant C array with the shape and the values of `values`."""
    places = "".join(f"[{n}]" for n in values.shape)
    flat = ", ".join(str(value) for value in values.ravel().tolist())
    return f"static const {c_type} {name}{places} = {{{flat}}};\n"
