"""numba itself, set up for this project; everything gets it from here, and late (`deferred`).

numba reads its environment when it is first imported; `drivers.compiled.jit` has set it by then.
"""

import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from pcpc.drivers.compiled import compile_cache, jit, ready_code
from pcpc.drivers.compiled.kinds import Kind, Signature

# numba.np.arraymath looks for the BLAS of scipy, which is a quarter of the start; none is used here
_HIDDEN = "scipy" not in sys.modules
if _HIDDEN:
    sys.modules["scipy"] = None  # type: ignore[assignment] # an import of it fails
import numba.np.arraymath  # noqa: E402  the environment must stand before numba reads it
from llvmlite.ir import Value  # noqa: E402
from numba import from_dtype, types  # noqa: E402
from numba.core import ir  # noqa: E402
from numba.core.cpu import CPUContext as Context  # noqa: E402  what lowers
from numba.core.datamodel.manager import DataModelManager  # noqa: E402
from numba.core.errors import NumbaExperimentalFeatureWarning, TypingError  # noqa: E402
from numba.core.typing.context import BaseContext as TypingContext  # noqa: E402  what types
from numba.core.typing.templates import Signature as CallSignature  # noqa: E402
from numba.extending import typeof_impl  # noqa: E402
from numba.np.numpy_support import carray  # noqa: E402

from pcpc.drivers.compiled import inner, kept_code  # noqa: E402
from pcpc.drivers.compiled.deferred import Deferred  # noqa: E402
from pcpc.drivers.compiled.target import Dispatcher, njit  # noqa: E402

__all__ = [
    "CallSignature", "Context", "DataModelManager", "TypingContext", "Values", "carray", "f8",
    "from_dtype", "i8", "njit", "numba", "types", "u1",
]  # fmt: skip

if _HIDDEN:
    del sys.modules["scipy"]  # from here on it can be imported
numba.config.reload_config()  # should somebody have imported numba before us
warnings.simplefilter("ignore", NumbaExperimentalFeatureWarning)  # blocks are first-class functions

f8, i8, u1 = types.float64, types.int64, types.uint8
Values: TypeAlias = Sequence[Value]  # of arguments


@typeof_impl.register(Deferred)
def _typeof_deferred(value: Deferred, context: Any) -> Any:
    return Dispatcher.targetdescr.typing_context.resolve_value_type(value.in_numba)


@typeof_impl.register(jit.Function)
def _typeof_function(value: jit.Function, context: Any) -> Any:
    return types.Dispatcher(value.in_numba)


def dispatcher(
    function: Any, signature: Signature | None, options: Any, for_callers: bool, part: bool
) -> Any:
    """Return what numba makes of a function, for its callers in compiled code."""
    with_types = () if signature is None else (signature.in_numba(),)
    made = njit(*with_types, **options)(function)
    made = kept_code.for_callers(made) if for_callers else made
    return inner.part(made) if part else made


def decorator(signature: Any, options: Any, for_callers: bool) -> Callable[[Any], Any]:
    """Return what compiles a function with a signature of numba's."""
    made = njit(*signature, **options)
    return lambda function: kept_code.for_callers(made(function)) if for_callers else made(function)


def compiled(
    source: ready_code.ImportedFunction,
    key: str,
    function: Any,
    types_of: Any,
    options: Any,
    by_address: bool = False,
) -> ready_code.ReadyFunction:
    """Compile what Python calls by its address, and keep it.

    `types_of()`: numba's signature, or the types of the arguments; any of numba's errors.
    `by_address`: nothing but its address is of use; TypingError where it calls Python.
    """
    with source.claim():
        if (found := source.load(key)) is not None:
            return found
        watch = compile_cache.watch
        if watch.listener is not None:
            watch.listener(watch.done)
        jitted: Any = njit(**options)(function)
        with inner.outermost():  # should a module be imported while another function is compiled
            jitted.compile(types_of())
        (result,) = jitted.overloads.values()
        mark = _mark_of_result(result.signature.return_type)
        module = result.library._final_module
        declared = (one.name for one in module.functions if one.is_declaration)
        calls_python = ready_code.needs_runtime(declared)
        if by_address and calls_python:
            at = ir.Loc(function.__code__.co_filename, function.__code__.co_firstlineno)
            raise TypingError(
                "a step cannot print or make text; write the value to an output", loc=at
            )
        if mark is None or calls_python:
            source.keep(key, "", "", b"")
            return ready_code.ReadyFunction(0, "")
        watch.done += 1
        name = result.fndesc.llvm_func_name
        address = result.library.get_pointer_to_function(name)  # now there is object code for sure
        if not result.library.has_dynamic_globals:  # addresses of large tables, say
            source.keep(key, name, mark, result.library._get_compiled_object())
        return ready_code.ReadyFunction(address, mark)


_RESULTS = {
    types.none: "",
    types.void: "",
    types.float64: "d",
    types.int64: "q",
    types.boolean: "?",
}


def _mark_of_result(kind: Any) -> str | None:
    """Return the mark of a result that Python can take itself."""
    if isinstance(kind, types.BaseTuple):
        members: Any = kind
        marks = [_RESULTS.get(types.unliteral(one), "") for one in members]
        return f"({','.join(marks)})" if all(marks) and marks else None
    return _RESULTS.get(types.unliteral(kind))


def types_of(arguments: tuple[Any, ...], kinds: tuple[Kind, ...]) -> tuple[Any, ...]:
    """Return the types of arguments, or of kinds where there are none."""
    return tuple(kind.in_numba() for kind in kinds) or tuple(map(numba.typeof, arguments))
