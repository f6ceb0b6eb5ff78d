"""Named views: what `p.kv_Nms_rad`, `x.w[n, j]` and `x.network` are in compiled code.

A View is a pointer to values whose names, places and shapes are part of its type; Cells are a
pointer to an array of fixed shape in it. A value is a float64, or one of each run of a batch
(`drivers.compiled.lanes`). So every access is a load or store at an address that
the compiler knows, up to the index. Nothing is checked at run time; `executive.own_laws.trial` does
that.

    View(layout)    x.name     a value, Cells for a port with a shape, another View for a group
    Cells(shape)    c[i, j]    a value;  c[i]  Cells without the first dimension;  len(c)
    flat(view)                 Cells of all values of a view, for what treats them alike

`layout` is a Layout: name, and (name, place, shape, sub-layout or None) of each field. What numba
makes of them stands in `drivers.compiled.view_types`. `executive.laws.ports` declares, and says
what the same expressions mean interpreted.
"""

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.deferred import Deferred
from pcpc.drivers.compiled.jit import JIT_OFF

Array: TypeAlias = NDArray[np.float64]  # what Cells are, interpreted
_TYPES = "pcpc.drivers.compiled.view_types"


class Field(NamedTuple):
    """One port or group: where it begins, in values, and its shape, () for a single value."""

    name: str
    place: int
    shape: tuple[int, ...]
    group: "Layout | None"


class Layout(NamedTuple):
    """The fields of a declaration by name, and its name for messages."""

    name: str
    fields: tuple[Field, ...]

    def field(self, name: str) -> Field | None:
        """Return the field of that name."""
        return next((field for field in self.fields if field.name == name), None)


def _flat_interpreted(view: Any) -> Any:
    return view.values()


flat: Any = _flat_interpreted if JIT_OFF else Deferred(_TYPES, "flat")
pointer_at: Any = Deferred(_TYPES, "pointer_at")
lane_rows: Any = Deferred(_TYPES, "lane_rows")
