"""How everything here is compiled: one set of numba options and a cache that cannot go stale.

Compiled code is kept by `drivers.compiled.kept_code`. The processor is `generic`, so that the cache
also serves another machine or an emulated one.

Everything else gets numba from here, because numba reads its environment when it is first imported.

Switches, read once at import (they select what is compiled, so they cannot be arguments):

    NUMBA_DISABLE_JIT=1      everything runs interpreted: debugging, and the bit-identity tests
    PCPC_LOOP=interpreted    only the loop runs interpreted: for buses that only python-can has
    PCPC_CPU=native          for this machine's processor: lanes in its widest registers; equal bits
"""

import os
import platform
import sys
import warnings
from collections.abc import Callable
from typing import Any

_FEATURES = {  # every machine of the kind has these; empty means what this one has
    "x86_64": "+64bit,+cmov,+cx8,+fxsr,+mmx,+sse,+sse2",
    "aarch64": "+fp-armv8,+neon",
}
if os.environ.get("PCPC_CPU") == "native":
    from llvmlite import binding

    os.environ.setdefault("NUMBA_CPU_NAME", binding.get_host_cpu_name())
    os.environ.setdefault("NUMBA_CPU_FEATURES", binding.get_host_cpu_features().flatten())
os.environ.setdefault("NUMBA_CPU_NAME", "generic")
os.environ.setdefault("NUMBA_CPU_FEATURES", _FEATURES.get(platform.machine(), ""))

# numba.np.arraymath looks for the BLAS of scipy, which is a quarter of the start; none is used here
_HIDDEN = "scipy" not in sys.modules
if _HIDDEN:
    sys.modules["scipy"] = None  # type: ignore[assignment] # an import of it fails
import numba.np.arraymath  # noqa: E402  the environment above must stand before numba reads it
from numba import from_dtype, types  # noqa: E402
from numba.core.errors import NumbaExperimentalFeatureWarning  # noqa: E402
from numba.np.numpy_support import carray  # noqa: E402

from pcpc.drivers.compiled import inner, kept_code  # noqa: E402

__all__ = [
    "JIT_OFF", "LOOP_INTERPRETED", "OPTIONS", "VIEW", "carray", "compiled", "f8", "from_dtype",
    "i8", "inline", "loop", "loop_function", "loop_inline", "loop_part", "numba", "types",
    "u1",
]  # fmt: skip

if _HIDDEN:
    del sys.modules["scipy"]  # from here on it can be imported
inner.install()
kept_code.install()
numba.config.reload_config()  # should somebody have imported numba before us
warnings.simplefilter("ignore", NumbaExperimentalFeatureWarning)  # blocks are first-class functions

JIT_OFF = bool(numba.config.DISABLE_JIT)  # type: ignore[attr-defined]
LOOP_INTERPRETED = JIT_OFF or os.environ.get("PCPC_LOOP") == "interpreted"

OPTIONS: dict[str, Any] = {
    "nogil": True,
    "cache": True,
    "error_model": "numpy",
    "fastmath": False,
    "boundscheck": False,
}

f8, i8, u1 = types.float64, types.int64, types.uint8
VIEW = types.float64[::1]


def inline(function: Callable[..., Any]) -> Any:
    """Compile a helper that stages and loops call; always inlined."""
    return kept_code.for_callers(numba.njit(forceinline=True, **OPTIONS)(function))


def compiled(*signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function with one explicit signature, or on first call when none is given."""
    made = numba.njit(*signature, **OPTIONS)
    return lambda function: kept_code.for_callers(made(function))


def loop(*signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """As `compiled`, for what is plain Python when the loop runs interpreted (libc, bus, cycle)."""
    if LOOP_INTERPRETED:
        return lambda function: function
    return numba.njit(*signature, **OPTIONS)


def loop_function(function: Callable[..., Any]) -> Any:
    """As `loop`, on first call: the loop's larger parts, which stay functions (compile time)."""
    return function if LOOP_INTERPRETED else numba.njit(**OPTIONS)(function)


def loop_part(function: Callable[..., Any]) -> Any:
    """As `loop_function`, compiled and kept by itself: perhaps by another process meanwhile."""
    return function if LOOP_INTERPRETED else inner.part(loop_function(function))


def loop_inline(function: Callable[..., Any]) -> Any:
    """As `inline`, for what must be plain Python when the loop runs interpreted."""
    return function if LOOP_INTERPRETED else numba.njit(forceinline=True, **OPTIONS)(function)
