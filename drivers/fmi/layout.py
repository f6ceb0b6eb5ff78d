"""What the loop reads of an instance of an FMU (no numba here).

    Head     the instance: its functions, where it stands, and its groups
    Group    all variables of one type and role: their references and values, the places of the
             values among the block's own, and of parameters what they were last

Functions and arrays are addresses. `told` and `told_s` are what doStep of FMI 3.0 writes.
"""

import numpy as np

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Cells, Element, Record, cells


class Status(NumberedEnum):
    """What an FMU returns, and what it asks for: to end the simulation, or it returned early."""

    OK, WARNING, DISCARD, ERROR, FATAL, ENDED = range(6)


class Doing(NumberedEnum):
    """Where it failed first."""

    NOTHING, SETTING, STEPPING, GETTING = range(4)


class Role(NumberedEnum):
    """Of variables."""

    PARAMETER, INPUT, OUTPUT = range(3)


TYPES = {  # of values, by the names of their setters: a group has the number of its own
    "Float64": "f8", "Real": "f8", "Float32": "f4", "Int8": "i1", "UInt8": "u1", "Int16": "i2",
    "UInt16": "u2", "Int32": "i4", "UInt32": "u4", "Integer": "i4", "Int64": "i8", "UInt64": "u8",
    "Boolean": "u1", "Boolean32": "i4",
}  # fmt: skip
DTYPES = [np.dtype(one) for one in TYPES.values()]
KINDS = {name: number for number, name in enumerate(TYPES)}
FLOAT64, INT8, INT64 = (KINDS[name] for name in ("Float64", "Int8", "Int64"))  # whole: from Int8 on


def _bounds(name: str) -> tuple[float, float]:
    """Return the lowest and the highest float64 that a whole number of a type may be."""
    if name.startswith("Boolean"):
        return 0.0, 1.0
    if KINDS[name] < INT8:
        return -np.inf, np.inf
    type_ = np.iinfo(TYPES[name])
    return float(type_.min), min(float(type_.max), float(np.nextafter(type_.max + 1.0, 0.0)))


LOWEST, HIGHEST = np.array([_bounds(name) for name in TYPES]).T.copy()

MOST_GROUPS = len(Role) * len(TYPES)


class ValueGroup(Element):
    """Of values that one call sets or gets."""

    role: int
    function: int
    kind: int
    n_references: int
    references: int
    n_values: int
    values: int
    places: int
    last: int


class Head(Record):
    """Of an instance."""

    version: int
    instance: int
    do_step: int
    steps: int
    status: int
    failed: int
    n_groups: int
    n_out: int
    told: int
    told_s: int
    groups: Cells[ValueGroup] = cells(MOST_GROUPS)


TOLD = Head.offset_of("told")
