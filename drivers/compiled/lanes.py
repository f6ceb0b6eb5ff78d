"""Lanes: WIDTH independent runs in one number, for the same stages as a single run.

A LANE holds a float64 of each run, a MASK the outcome of a comparison of each. + - * /, negation,
abs and comparison work on all at once and give each run the bits that it gets alone, because IEEE
754 says so of each of them. `executive.laws.emath` gives `where`, `pow2`, `sqrt` their meaning.

What a stage decides by `if`, or counts with `int`, can only be the same in all lanes: it is, where
it depends on configuration. Where the lanes differ, the call ends with LanesDiffer and the runs are
done one by one (`executive.batch`); nothing is ever computed by the wrong branch.

    bool(mask)   True if all are, False if none is
    int(lane)    the number that all have
    table(n)     memory for n values of each run: value i of lane l at [i, l]

What numba makes of them stands in `drivers.compiled.lane_types`.
"""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.deferred import Deferred

WIDTH = 8  # doubles in the widest register of today; narrower ones take two or four
_ALIGNED = 8 * WIDTH
Lane: TypeAlias = float  # mypy takes them for what they are in a single run
Mask: TypeAlias = bool


class LanesDiffer(Exception):
    """The lanes would take different branches, or count differently."""


def table(rows: int) -> NDArray[np.float64]:
    """Return zeroed memory (rows, WIDTH) at an address that the registers insist on."""
    memory = np.zeros(8 * rows * WIDTH + _ALIGNED, np.uint8)
    first = -memory.ctypes.data % _ALIGNED
    return memory[first : first + 8 * rows * WIDTH].view(np.float64).reshape(rows, WIDTH)


in_single: Any = Deferred("pcpc.drivers.compiled.lane_types", "in_single")
