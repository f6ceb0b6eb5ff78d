"""Structures: what `n.k`, `n.wire.errno`, `n.v[i]` and `n.rx.frames[i].dlc` are in compiled code.

A Structure is a pointer to one element of a structured numpy array. Its fields are numbers, Cells
(`drivers.compiled.views`), further Structures and Cells of them, so that every access is a load or
store at an address that the compiler knows, up to the index. numba's own record makes an array of
each field and takes a negative index from its end: that was a quarter of the loop's cycle. A name
of a `Numbered` class is its number.

    structure(dtype)       the type of `array[0]` for functions with a signature; without one it is
                           known once the dtype was named here
    data_of(frame)         the data bytes of a frame, Cells
    copy(target, source)   a frame's bytes into another's place
    words(structure)       its int64, Cells; `words_of` outside of the loop
"""

from typing import Any

import numpy as np

from pcpc.drivers.compiled import kinds
from pcpc.drivers.compiled.deferred import Deferred, is_open
from pcpc.drivers.compiled.jit import LOOP_INTERPRETED
from pcpc.drivers.compiled.records import Byte, Cells
from pcpc.drivers.compiled.rows import CLASSIC_BYTES, FLAGS, FRAME_BYTES, HEAD_BYTES, Flag

_TYPES = "pcpc.drivers.compiled.structure_types"
_made: Any = Deferred(_TYPES, "structure")


def structure(dtype: np.dtype[Any]) -> kinds.Kind:
    """Return the type of a structure of `dtype`, which from now on has it everywhere."""
    kind = kinds.structure(dtype, lambda bare: _made.in_numba(bare))
    if is_open():
        kind.in_numba()
    return kind


def words_of(structure: Any) -> Any:
    """Return the int64 of a structure or array that has nothing else, as an array on its memory."""
    return np.asarray(structure).reshape(-1).view(np.int64)


def _data_interpreted(frame: Cells[Byte]) -> Any:
    return frame[HEAD_BYTES:]


def _copy_interpreted(target: Cells[Byte], source: Cells[Byte]) -> None:
    n = FRAME_BYTES if source[FLAGS] & Flag.FD else CLASSIC_BYTES
    target[:n] = source[:n]


data_of: Any = _data_interpreted if LOOP_INTERPRETED else Deferred(_TYPES, "data_of")
words: Any = words_of if LOOP_INTERPRETED else Deferred("pcpc.drivers.compiled.view_types", "flat")
copy: Any = _copy_interpreted if LOOP_INTERPRETED else Deferred(_TYPES, "copy")
