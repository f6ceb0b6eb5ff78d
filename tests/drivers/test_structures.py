"""Structures: compiled code reads and writes the memory that numpy sees under the same names."""

from typing import Any

import numpy as np
import pytest

from pcpc.drivers.compiled.jit import loop_function, numba
from pcpc.drivers.compiled.structures import copy, data_of, structure, words, words_of

INNER = np.dtype([("flag", "<i8"), ("table", "<f8", (3, 4)), ("byte", "u1", (5,))], align=True)
OUTER = np.dtype(
    [("head", "u1", (3,)), ("gain", "<f8"), ("inner", INNER), ("frame", "u1", (2, 72)),
     ("count", "<i8"), ("words", "<i8", (6,))],
    align=True,
)  # fmt: skip
COUNTS = np.dtype([("first", "<i8"), ("rows", [("a", "<i8"), ("b", "<i8", (2,))], (3,))])
structure(OUTER)
structure(COUNTS)


@loop_function
def work(n: Any, row: Any) -> Any:
    """Use every kind of field."""
    inner = n.inner
    n.count += 3
    inner.flag = n.count > 5
    for i in range(4):
        inner.table[row, i] = n.gain * i + inner.table[row - 1, i]
    n.gain = inner.table[row, 3]
    for i in range(len(inner.byte)):
        inner.byte[i] = 250 + i + n.words[i]
    values = inner.table[row]
    values[0] = n.words[row] + row
    return n.gain


@loop_function
def use_frames(n: Any) -> None:
    """Change a frame's data and copy the frame."""
    data_of(n.frame[0])[7] = n.count
    copy(n.frame[1], n.frame[0])


def record(seed: int) -> Any:
    """Return an OUTER with known contents."""
    made = np.recarray(1, OUTER)
    made.view(np.uint8)[:] = 0
    n, rng = made[0], np.random.default_rng(seed)
    n.gain, n.count = rng.normal(), seed
    n.inner.table[:] = rng.normal(size=(3, 4))
    n.words[:] = rng.integers(0, 9, 6)
    n.frame[0] = rng.integers(0, 256, 72)
    return n


@pytest.mark.parametrize("seed", range(1, 7))
def test_a_structure_is_used_as_numpy_uses_the_record(seed: int) -> None:
    ours, theirs = record(seed), record(seed)
    row = 1 + seed % 2
    assert work(ours, row) == work.py_func(theirs, row)
    assert ours.tobytes() == theirs.tobytes()
    assert ours.tobytes() != record(seed).tobytes(), "nothing was written"


@pytest.mark.parametrize(("flags", "copied"), [(0, 16), (3, 16), (4, 72), (7, 72)])
def test_a_frame_is_copied_as_long_as_its_kind_and_its_data_begin_at_byte_8(
    flags: int, copied: int
) -> None:
    n = record(7)
    n.frame[0, 5] = flags
    wanted = n.frame[0].tolist()
    wanted[15] = 7
    use_frames(n)
    assert n.frame[0].tolist() == wanted
    assert n.frame[1].tolist() == [*wanted[:copied], *[0] * (72 - copied)]


def test_a_field_that_is_not_there_and_a_whole_table_are_refused() -> None:
    @loop_function
    def read(n: Any) -> Any:
        return n.conut

    @loop_function
    def write(n: Any) -> None:
        n.inner = n.inner

    with pytest.raises(numba.core.errors.TypingError, match="conut"):
        read(record(1))
    with pytest.raises(TypeError, match="set them one by one"):
        write(record(1))


@loop_function
def weighed(n: Any) -> Any:
    """Return a sum that each word and its place change."""
    every, total = words(n), 0
    for i in range(len(every)):
        total += (i + 1) * every[i]
    return total


def test_the_words_of_a_structure_are_those_of_its_memory() -> None:
    n = np.arange(10, 20).view(COUNTS)[0:1].view(np.recarray)[0]
    assert words_of(n).tolist() == list(range(10, 20))
    assert weighed(n) == sum((i + 1) * (i + 10) for i in range(10))
    with pytest.raises(numba.core.errors.TypingError, match="No implementation of function"):
        weighed(record(1))
