"""What compiled code can name, while numba is not there: it is imported when something is compiled.

A start that finds all its code kept (`drivers.compiled.ready_code`) needs no numba, whose import is
a quarter of it. So intrinsics stand in modules that import numba, and in their place a Deferred;
numba types it as what it stands for.
"""

from importlib import import_module
from typing import Any

from pcpc.drivers.compiled import kinds

_NUMBA = "pcpc.drivers.compiled.in_numba"
_TYPES = ("view_types", "structure_types", "lane_types", "libc_types", "stage_types")
_more: list[str] = []  # modules of others that tell numba something
_state = {"open": False}


class Deferred:
    """Something of a module that imports numba."""

    def __init__(self, module: str, name: str) -> None:
        self._module, self._name = module, name
        self._found: Any = None

    @property
    def in_numba(self) -> Any:
        """What it is, for numba."""
        if self._found is None:
            open_numba()
            self._found = getattr(import_module(self._module), self._name)
        return self._found

    def __call__(self, *arguments: Any) -> Any:
        """Do what numba says to who calls from Python what is for compiled code."""
        return self.in_numba(*arguments)

    def __reduce__(self) -> Any:
        return Deferred, (self._module, self._name)


def is_open() -> bool:
    """Return whether numba is there, with all types of ours."""
    return _state["open"]


def open_numba() -> Any:
    """Return `drivers.compiled.in_numba`, and let numba know all types of ours."""
    in_numba = import_module(_NUMBA)
    if not _state["open"]:
        _state["open"] = True
        for name in _TYPES:
            import_module(f"pcpc.drivers.compiled.{name}")
        for name in _more:
            import_module(name)
        kinds.complete()
    return in_numba


def with_numba(module: str) -> None:
    """Import a module as soon as numba is there: it has types or functions for it."""
    _more.append(module)
    if _state["open"]:
        import_module(module)
