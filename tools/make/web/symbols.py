"""Numbers a cycle that are not known yet: what is calculated with them is written down.

    trace = Trace()
    x = trace.column("plant:arm.q_rad")
    np.abs(x) + 1.0         trace.nodes: [["column", "plant:arm.q_rad"], ["absolute", 0], ...]

A node is an operation, by the name of numpy's function, and the numbers of the nodes that it takes;
those of `number`, `column`, `merit` are its own. A branch on a number of the whole run (`merit`)
becomes an `if` with both ways. What cannot be written down raises Unrecordable.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

MOST_BRANCHES = 256
UNARY = (
    "absolute", "negative", "positive", "sign", "sqrt", "square", "cbrt", "exp", "expm1", "log",
    "log1p", "log2", "log10", "sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh",
    "tanh", "floor", "ceil", "trunc", "rint", "isfinite", "isnan", "isinf", "logical_not",
    "deg2rad", "rad2deg",
)  # fmt: skip
BINARY = (
    "add", "subtract", "multiply", "divide", "power", "remainder", "maximum", "minimum", "fmax",
    "fmin", "hypot", "arctan2", "less", "less_equal", "greater", "greater_equal", "equal",
    "not_equal", "logical_and", "logical_or", "logical_xor",
)  # fmt: skip
_ALIASES = {
    "fabs": "absolute", "abs": "absolute", "radians": "deg2rad", "degrees": "rad2deg",
    "float_power": "power", "true_divide": "divide", "mod": "remainder", "pow": "power",
    "atan2": "arctan2", "asin": "arcsin", "acos": "arccos", "atan": "arctan",
}  # fmt: skip
_BITWISE = {
    "bitwise_and": "logical_and", "bitwise_or": "logical_or", "bitwise_xor": "logical_xor",
    "invert": "logical_not", "bitwise_invert": "logical_not",
}  # fmt: skip
_LOGICAL = (
    "less", "less_equal", "greater", "greater_equal", "equal", "not_equal", "logical_and",
    "logical_or", "logical_xor", "logical_not", "isfinite", "isnan", "isinf",
)  # fmt: skip


class Unrecordable(BaseException):
    """What cannot be written down; no Exception, for no evaluation shall take it for its own."""


class _Fork(BaseException):
    """A branch whose way nobody has said yet."""

    def __init__(self, condition: int) -> None:
        super().__init__(condition)
        self.condition = condition


@dataclass(frozen=True)
class Fork:
    """What a function returns where the node `condition` holds, and where not."""

    condition: int
    yes: Any
    no: Any


class Trace:
    """What was calculated; equal calculations are one node."""

    def __init__(self) -> None:
        self.nodes: list[list[Any]] = []
        self.settings = set[str]()  # of the rig that were asked for, whose values are numbers here
        self._known: dict[tuple[Any, ...], int] = {}
        self._way: list[bool] = []
        self._taken = 0

    def node(self, *what: Any) -> int:
        """Return the number of a node."""
        if what not in self._known:
            self._known[what] = len(self.nodes)
            self.nodes.append(list(what))
        return self._known[what]

    def symbol(self, *what: Any, kind: str = "vector", logical: bool = False) -> "Symbol":
        """Return what stands for a node."""
        return Symbol(self, self.node(*what), kind, logical)

    def column(self, name: str) -> "Symbol":
        """Return what stands for a recorded variable NODE:NAME."""
        return self.symbol("column", name)

    def number(self, value: float, kind: str = "scalar", logical: bool = False) -> "Symbol":
        """Return what stands for a number that is known."""
        return self.symbol("number", plain(float(value)), kind=kind, logical=logical)

    def branch(self, condition: int) -> bool:
        """Return which way is gone at a branch; the first time each way is tried."""
        if self._taken == len(self._way):
            raise _Fork(condition)
        self._taken += 1
        return self._way[self._taken - 1]

    def of(self, function: Callable[[], Any]) -> "Symbol":
        """Return what a function returns, with both ways of its branches."""

        def joined_symbol(found: Any) -> Symbol:
            if not isinstance(found, Fork):
                return self.operand(found)
            yes, no = joined_symbol(found.yes), joined_symbol(found.no)
            return self.symbol("if", found.condition, yes.index, no.index, kind=yes.kind)

        return joined_symbol(self.ways(function))

    def ways(self, function: Callable[[], Any]) -> Any:
        """Return what a function returns, a Fork where it branches."""
        left = [MOST_BRANCHES]

        def walk(way: list[bool]) -> Any:
            left[0] -= 1
            if left[0] < 0:
                raise Unrecordable("it branches too often")
            self._way, self._taken = way, 0
            try:
                return function()
            except _Fork as fork:
                return Fork(fork.condition, walk([*way, True]), walk([*way, False]))
            finally:
                self._way, self._taken = [], 0

        return walk([])

    def operand(self, given: Any) -> "Symbol":
        """Return what stands for a number or a symbol."""
        if isinstance(given, Symbol):
            return given
        if isinstance(given, bool | np.bool_):
            return self.number(float(given), logical=True)
        if isinstance(given, int | float | np.integer | np.floating) or (
            isinstance(given, np.ndarray) and given.shape == () and given.dtype.kind in "iuf"
        ):
            return self.number(float(given))
        raise Unrecordable(f"it takes a {type(given).__name__}")

    def apply(self, name: str, *given: Any) -> "Symbol":
        """Return what an operation makes of symbols and numbers."""
        parts = [self.operand(one) for one in given]
        if name in _BITWISE:
            if not all(one.logical for one in parts):
                raise Unrecordable(f"it takes the bits of numbers ({name})")
            name = _BITWISE[name]
        name = _ALIASES.get(name, name)
        if name not in (UNARY if len(parts) == 1 else BINARY):
            raise Unrecordable(f"it calls {name}")
        logical = name in _LOGICAL
        if not logical and all(one.logical for one in parts):
            raise Unrecordable(f"it calculates with conditions ({name})")
        return self.symbol(
            name, *(one.index for one in parts), kind=self._kind(parts), logical=logical
        )

    def where(self, condition: Any, yes: Any, no: Any) -> "Symbol":
        """Return what stands for np.where."""
        parts = [self.operand(one) for one in (condition, yes, no)]
        logical = parts[1].logical and parts[2].logical
        indices = (one.index for one in parts)
        return self.symbol("where", *indices, kind=self._kind(parts), logical=logical)

    def columns(self, given: Any) -> "Symbol":
        """Return what stands for np.column_stack of two."""
        parts = [self.operand(one) for one in given]
        if [one.kind for one in parts] != ["vector", "vector"]:
            raise Unrecordable("it takes other columns than two")
        return self.symbol("columns", *(one.index for one in parts), kind="pair")

    def _kind(self, parts: "list[Symbol]") -> str:
        kinds = {one.kind for one in parts}
        if "pair" in kinds:
            raise Unrecordable("it calculates with columns")
        return "vector" if "vector" in kinds else "scalar"


class Symbol(NDArrayOperatorsMixin):
    """A node of a trace, as an array (n,) or (n, 2), or as a number of the whole run."""

    def __init__(self, trace: Trace, index: int, kind: str, logical: bool) -> None:
        self.trace, self.index, self.kind, self.logical = trace, index, kind, logical

    def __array_ufunc__(self, ufunc: Any, method: str, *given: Any, **more: Any) -> "Symbol":
        """Write down what a ufunc does."""
        if method != "__call__" or more:
            raise Unrecordable(f"it calls {ufunc.__name__} with more than numbers")
        return self.trace.apply(ufunc.__name__, *given)

    def __array_function__(self, function: Any, types: Any, given: Any, more: Any) -> "Symbol":
        """Write down what another function of numpy does."""
        trace = self.trace
        known: dict[Any, Callable[..., Symbol]] = {
            np.where: trace.where,
            np.column_stack: trace.columns,
            np.full_like: lambda like, value: trace.number(value, "vector"),
            np.clip: lambda x, low, high: trace.apply(
                "minimum", trace.apply("maximum", x, low), high
            ),
        }
        if function not in known or more:
            raise Unrecordable(f"it calls {function.__name__}")
        return known[function](*given)

    def __bool__(self) -> bool:
        if self.kind != "scalar":
            raise Unrecordable("it branches on a number a cycle")
        return self.trace.branch(self.index)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        raise Unrecordable(f"it asks for {name} of numbers a cycle")

    def _refuse(self, *given: Any) -> NoReturn:
        raise Unrecordable("it takes numbers a cycle apart, or calls an unknown function")

    __float__ = __int__ = __index__ = __len__ = __iter__ = __getitem__ = __array__ = _refuse
    __setitem__ = __round__ = __hash__ = _refuse


def plain(value: float) -> float | str:
    """Return a number as JSON can hold it; JavaScript's Number(...) reads both."""
    if math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
