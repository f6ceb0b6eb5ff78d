"""Every operation on lanes gives each lane what the same operation on one number gives, in bits."""

import itertools
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pcpc.drivers.compiled.jit import njit
from pcpc.drivers.compiled.lanes import WIDTH, LanesDiffer, in_single, table
from pcpc.drivers.compiled.views import lane_rows
from pcpc.executive.laws.emath import pow2, sqrt, where

TINY, HUGE = 5e-324, 1.7976931348623157e308
SPECIAL = (0.0, -0.0, 1.0, -1.5, TINY, -TINY, HUGE, -HUGE, np.inf, -np.inf, np.nan, 1.0 + 2**-52)
PAIRS = list(itertools.product(SPECIAL, SPECIAL))
BINARY = (
    operator.add, operator.sub, operator.mul, operator.truediv, operator.lt, operator.le,
    operator.gt, operator.ge, operator.eq, operator.ne,
)  # fmt: skip


def in_lanes(function: Callable[..., Any], *columns: Any) -> list[float]:
    """Return function(a, b, ...) of numbers, WIDTH at a time."""
    count = -(-len(columns[0]) // WIDTH)
    memory = table((len(columns) + 1) * count)
    for i, column in enumerate(columns):
        padded = np.resize(np.array(column, float), count * WIDTH)
        memory[i * count : (i + 1) * count] = padded.reshape(count, WIDTH)
    function(memory.reshape(-1), count)
    return memory[-count:].ravel()[: len(columns[0])].tolist()  # type: ignore[no-any-return]


def same(found: list[float], wanted: list[float]) -> bool:
    """Return whether the bits are equal, every NaN as the same one."""
    a, b = (np.array(one, float) for one in (found, wanted))
    return bool(np.array_equal(np.isnan(a), np.isnan(b))) and (
        a[~np.isnan(a)].tobytes() == b[~np.isnan(b)].tobytes()
    )


@pytest.mark.parametrize("function", BINARY, ids=lambda one: one.__name__)
def test_two_operands(function: Callable[[Any, Any], Any]) -> None:
    compares = function in BINARY[4:]

    @njit(error_model="numpy")
    def lanes(values: Any, n: Any) -> None:
        w = lane_rows(values)
        for i in range(n):
            found = function(w[i], w[n + i])
            w[2 * n + i] = where(found, 1.0, 0.0) if compares else found

    @njit(error_model="numpy")
    def one(a: Any, b: Any) -> Any:
        return function(a, b)

    first, second = zip(*PAIRS, strict=True)
    wanted = [float(one(a, b)) for a, b in PAIRS]
    assert same(in_lanes(lanes, first, second), wanted)


@njit(error_model="numpy")
def _one_operand(values: Any, n: Any) -> None:
    w = lane_rows(values)
    for i in range(n):
        w[n + i] = abs(w[i])
        w[2 * n + i] = -w[i]
        w[3 * n + i] = sqrt(w[i])
        w[4 * n + i] = in_single(w[i])
        w[5 * n + i] = where((w[i] > 0.0) & ~(w[i] > 2.0), w[i], 7.0)
        w[6 * n + i] = where((w[i] > 1.0) | True, 3 * w[i] + 1, w[i])


def test_one_operand_and_what_joins_masks() -> None:
    count = 2
    memory = table(7 * count)
    memory[:count] = np.resize(np.array(SPECIAL), count * WIDTH).reshape(count, WIDTH)
    _one_operand(memory.reshape(-1), count)
    x = memory[:count].ravel()
    with np.errstate(all="ignore"):
        wanted = [np.abs(x), -x, np.where(x >= 0.0, np.sqrt(x), np.nan),
                  x.astype(np.float32).astype(float), np.where((x > 0) & ~(x > 2), x, 7.0),
                  3 * x + 1]  # fmt: skip
    for i, column in enumerate(wanted, 1):
        found = memory[i * count : (i + 1) * count].ravel()
        assert same(found.tolist(), column.tolist()), i


@njit(error_model="numpy")
def _powers(values: Any, n: Any) -> None:
    w = lane_rows(values)
    for i in range(n):
        w[n + i] = pow2(w[i])


def test_powers_of_two() -> None:
    k = [-1022.0, -3.0, 0.0, 1.0, 52.0, 1023.0, 7.0, -1.0]
    assert same(in_lanes(_powers, k), [2.0**one for one in k])


@njit(error_model="numpy")
def _decides(values: Any) -> Any:
    w, done = lane_rows(values), 0
    if w[0] > 0.5:
        done += 1
    for _ in range(int(w[1])):
        done += 10
    return done


def test_what_all_lanes_agree_in_is_decided_and_nothing_else() -> None:
    memory = table(2)
    memory[0], memory[1] = 1.0, 3.0
    assert _decides(memory.reshape(-1)) == 31
    memory[0] = 0.0
    assert _decides(memory.reshape(-1)) == 30
    for row, value in ((0, 1.0), (1, 4.0), (1, np.nan)):
        memory[0], memory[1] = 0.0, 3.0
        memory[row, 5] = value
        with pytest.raises(LanesDiffer):
            _decides(memory.reshape(-1))


def test_memory_of_lanes_lies_where_the_widest_registers_want_it() -> None:
    for rows in (1, 3, 1000):
        assert table(rows).ctypes.data % (8 * WIDTH) == 0
