"""A block's step in plain Python, called by the compiled loop in the place of the rig's own.

It gets what every step gets, t, dt and the values of parameters, states, inputs and outputs, and
writes the outputs. It takes some 10 us instead of 0.1, and Python decides when it comes back: for
virtual time only. What it wrote stands in the log; a replay takes it from there.
"""

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.jit import LOOP_INTERPRETED

Vector = NDArray[np.float64]
Step = Callable[[float, float, Vector, Vector, Vector, Vector], None]
_DOUBLES = ctypes.POINTER(ctypes.c_double)
_KIND = ctypes.CFUNCTYPE(  # numba's own convention: status, place of the result, of an exception
    ctypes.c_int32,
    ctypes.c_void_p,
    ctypes.c_void_p,
    ctypes.c_double,
    ctypes.c_double,
    *[_DOUBLES] * 4,
)
_DONE = 0


class External:
    """What stands in for a step; `entry` as of `compiled.stage.Stage`, for as long as this lives.

    `declared`: the ports of the step that it replaces. `step` may not raise.
    """

    def __init__(self, declared: tuple[Any, ...], step: Step) -> None:
        self.declared, self._step = declared, step
        self._sizes = [ports.size for ports in declared]
        self._views: list[Vector] = []
        self._kept = _KIND(self._callback)

    @property
    def entry(self) -> Any:
        """An address, for the compiled loop."""
        if LOOP_INTERPRETED:
            return self._step
        return ctypes.cast(self._kept, ctypes.c_void_p).value

    def _callback(self, _result: Any, _error: Any, t: float, dt: float, *pointers: Any) -> int:
        if not self._views:  # the table does not move
            self._views = [
                np.ctypeslib.as_array(pointer, (size,)) if size else np.empty(0)
                for pointer, size in zip(pointers, self._sizes, strict=True)
            ]
        self._step(t, dt, *self._views)
        return _DONE
