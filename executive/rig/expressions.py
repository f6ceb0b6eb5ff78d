"""Conditions on recorded variables, as a rig's requirements state them, with their units checked.

    abs(controller.e_rad) < 2 mrad and plant:barrel.theta_rad > -0.1

names       recorded variables, of another node as NODE:NAME; signals of the rig's evaluation
numbers     with a unit or without one: a bare number has the unit of what it stands beside
operators   + - * /, abs min max sqrt, rate(x) (change a second); < <= > >= == != also in chains;
            and or not

The margin of a condition is how far it is from turning over: of a < b it is b - a, of `and` the
smallest, of `or` the largest, `not` turns the sign. It is negative exactly where the condition does
not hold: where 1 < 1 has the margin 0, `BARELY` stands for it. NaN holds nowhere, margin -inf.
Python's own parser reads it; nothing is ever run.
"""

import ast
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.rig.units import AFTER_NUMBER, NONE, Unit, unit

Vector = NDArray[np.float64]
Units = Callable[[str], Unit | None]  # of a variable; None for any. Raises ExpressionError

BARELY = -float(np.finfo(np.float64).tiny)  # a margin of 0 of what does not hold
_WORDS = ("and", "or", "not")
_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?"
_TOKEN = re.compile(
    rf"(?P<number>{_NUMBER})(?P<unit>{AFTER_NUMBER})?(?![\w.])"
    r"|(?P<name>(?:(?:executive|local|plant(?:_\d+)?):)?[A-Za-z_]\w*(?:\.\w+)*)(?![\w.]|\s*\()"
)
_PLACEHOLDER = re.compile(r"_(\d+)_")
_ARITHMETIC: dict[type, tuple[str, Any]] = {
    ast.Add: ("+", np.add), ast.Sub: ("-", np.subtract),
    ast.Mult: ("*", None), ast.Div: ("/", None),
}  # fmt: skip
_COMPARED: dict[type, str] = {
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
_SIGNS = {  # what holds, and the opposite
    "<": (operator.lt, ">="), "<=": (operator.le, ">"), ">": (operator.gt, "<="),
    ">=": (operator.ge, "<"), "==": (operator.eq, "!="), "!=": (operator.ne, "=="),
}  # fmt: skip


class ExpressionError(ValueError):
    """What is wrong in an expression, and what to do, in one line."""


@dataclass(frozen=True)
class Rows:
    """Cycles that have a record of all that is asked for, each column (n,) in base units."""

    cycle: NDArray[np.int64]
    columns: Mapping[str, Vector]
    period_s: float

    def __len__(self) -> int:
        return len(self.cycle)

    def part(self, rows: slice) -> "Rows":
        """Return some of the rows."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        return Rows(self.cycle[rows], columns, self.period_s)

    def then(self, more: "Rows") -> "Rows":
        """Return these rows and those that follow."""
        columns = {k: np.concatenate((self.columns[k], more.columns[k])) for k in more.columns}
        return Rows(np.concatenate((self.cycle, more.cycle)), columns, self.period_s)


@dataclass(frozen=True)
class Comparison:
    """A comparison at one cycle: what was compared, its value and limit, in `unit`."""

    what: str
    value: float
    limit: float
    unit: Unit


@dataclass(frozen=True)
class Value:
    """A number a cycle, in base units; `unit` None adapts to what it stands beside.

    `parts`: how `at` makes it, for those who cannot call it: the name of a function of numpy, abs,
    sqrt, rate, `column` or `number`; then values, names and numbers.
    """

    text: str
    unit: Unit | None
    at: Callable[[Rows], Any]
    names: frozenset[str] = frozenset()
    number: Fraction | None = None  # of a constant, in base units
    parts: tuple[Any, ...] = ()

    def taken_as(self, other: Unit | None) -> "Value":
        """Return a bare number, or a value of unknown unit, in the unit of its neighbour."""
        if self.unit is not None or other is None:
            return self
        if self.number is not None:
            return _constant(self.text, self.number * other.factor, other)
        factor = float(other.factor)
        parts = "multiply", self, _constant("", other.factor, None)
        return Value(self.text, other, lambda rows: self.at(rows) * factor, self.names, parts=parts)


@dataclass(frozen=True)
class Condition:
    """What holds or not in a cycle.

    `margin`  of each row; negative exactly where it does not hold
    `said`    of row i: the comparison that decided
    `inverse` what holds where this does not; NaN apart, where neither does
    `parts`   `and` or `or` with conditions, or a sign, what it compares, and `said`'s two values
    """

    text: str
    names: frozenset[str]
    margin: Callable[[Rows], Vector]
    said: Callable[[Rows, int], Comparison]
    inverse: "Callable[[], Condition]"
    parts: tuple[Any, ...] = ()


def condition(text: str, units: Units) -> Condition:
    """Return the condition that a text states; ExpressionError."""
    found = _Reader(text, units).whole()
    if isinstance(found, Value):
        raise ExpressionError(f"{text} is a value; expected a condition, like {found.text} > 0")
    return found


def value(text: str, units: Units) -> Value:
    """Return the value that a text states; ExpressionError."""
    found = _Reader(text, units).whole()
    if isinstance(found, Condition):
        raise ExpressionError(f"{text} is a condition; expected a value")
    return found


def comparison(a: Value, sign: str, b: Value) -> Condition:
    """Return a comparison; ExpressionError for different units."""
    text = f"{a.text} {sign} {b.text}"
    a, b = _in_one_unit(a, b, text)
    left, right = (b, a) if a.number is not None else (a, b)  # the value, and its limit
    shown = left.unit or right.unit or NONE
    holds, opposite = _SIGNS[sign]

    def margin(rows: Rows) -> Vector:
        with np.errstate(invalid="ignore", over="ignore"):
            x, y, _ = np.broadcast_arrays(a.at(rows), b.at(rows), rows.cycle)
            held, far = holds(x, y), np.abs(x - y)
        far = np.where(np.isnan(far), 0.0, far)  # of equal infinities
        found = np.where(held, 0.0 if sign == "==" else far, np.minimum(-far, BARELY))
        return np.where(np.isnan(x) | np.isnan(y), -np.inf, found)

    def said(rows: Rows, i: int) -> Comparison:
        x, y = (np.broadcast_to(one.at(rows), len(rows))[i] for one in (left, right))
        factor = float(shown.factor)
        return Comparison(left.text, float(x) / factor, float(y) / factor, shown)

    return Condition(
        text,
        a.names | b.names,
        margin,
        said,
        lambda: comparison(a, opposite, b),
        (sign, a, b, left, right, shown),
    )


class _Reader:
    """One expression: names and numbers are put away, the rest is read by Python's parser."""

    def __init__(self, text: str, units: Units) -> None:
        self.text, self.units = text, units
        self.operands: list[Value] = []
        self.prepared = _TOKEN.sub(self._put_away, text).strip()

    def whole(self) -> Value | Condition:
        try:
            return self.read(ast.parse(self.prepared, mode="eval").body)
        except ExpressionError:
            raise
        except (SyntaxError, ValueError, MemoryError, RecursionError):
            what = f"{self.text!r} is not an expression; expected one like abs(x) < 2 mrad"
            raise ExpressionError(what) from None

    def wrong(self, what: str) -> ExpressionError:
        return ExpressionError(f"{self.text} {what}")

    def _put_away(self, found: re.Match[str]) -> str:
        if (name := found["name"]) in _WORDS:
            return found[0]
        if name:
            self.operands.append(_variable(name, self.units(name)))
        else:
            own = unit(found["unit"].strip()) if found["unit"] else None
            number = Fraction(found["number"]) * (own.factor if own else 1)
            self.operands.append(_constant(found[0], number, own))
        return f"_{len(self.operands) - 1}_"

    def read(self, node: ast.AST) -> Value | Condition:
        """Return what a part of the tree stands for."""
        text = ast.get_source_segment(self.prepared, node) or ""
        text = _PLACEHOLDER.sub(lambda found: self.operands[int(found[1])].text, text)
        match node:
            case ast.Name(id=name) if found := _PLACEHOLDER.fullmatch(name):
                return self.operands[int(found[1])]
            case ast.UnaryOp(op=ast.Not(), operand=one):
                return self._condition(one).inverse()
            case ast.UnaryOp(op=ast.UAdd(), operand=one):
                return self._value(one)
            case ast.UnaryOp(op=ast.USub(), operand=one):
                return _product(text, _constant("-1", Fraction(-1), None), "*", self._value(one))
            case ast.BinOp(left=a, op=ast.Add() | ast.Sub() as op, right=b):
                return _combination(text, _ARITHMETIC[type(op)][1], self._value(a), self._value(b))
            case ast.BinOp(left=a, op=ast.Mult() | ast.Div() as op, right=b):
                return _product(text, self._value(a), _ARITHMETIC[type(op)][0], self._value(b))
            case ast.Compare(left=a, ops=ops, comparators=more) if all(
                type(op) in _COMPARED for op in ops
            ):
                sides = pairwise([self._value(one) for one in (a, *more)])
                signs = [_COMPARED[type(op)] for op in ops]
                return _junction(
                    [comparison(x, sign, y) for sign, (x, y) in zip(signs, sides, strict=True)],
                    "and",
                )
            case ast.BoolOp(op=op, values=parts):
                word = "and" if isinstance(op, ast.And) else "or"
                return _junction([self._condition(one) for one in parts], word)
            case ast.Call(func=ast.Name(id=name), args=given, keywords=[]):
                return self._call(text, name, [self._value(one) for one in given])
        known = "names, numbers, + - * /, comparisons, and or not, abs min max sqrt rate"
        raise self.wrong(f"is more than {known}")

    def _value(self, node: ast.AST) -> Value:
        found = self.read(node)
        if isinstance(found, Condition):
            raise self.wrong(f"calculates with the condition {found.text}")
        return found

    def _condition(self, node: ast.AST) -> Condition:
        found = self.read(node)
        if isinstance(found, Value):
            raise self.wrong(f"needs a condition for {found.text}, like {found.text} > 0")
        return found

    def _call(self, text: str, name: str, given: list[Value]) -> Value:
        if name in ("min", "max") and len(given) > 1:
            which = np.minimum if name == "min" else np.maximum
            return reduce(lambda a, b: _combination(text, which, a, b), given)
        if name not in _FUNCTIONS or len(given) != 1:
            raise self.wrong(
                "calls an unknown function; known: abs sqrt rate of one value, min max of several"
            )
        (one,), (act, own) = given, _FUNCTIONS[name]
        made = one.unit and own(one.unit)
        return Value(text, made, lambda rows: act(rows, one.at(rows)), one.names, parts=(name, one))


def _variable(name: str, own: Unit | None) -> Value:
    factor = 1.0 if own is None else float(own.factor)

    def at(rows: Rows) -> Vector:
        return rows.columns[name] if factor == 1.0 else rows.columns[name] * factor

    return Value(name, own, at, frozenset({name}), parts=("column", name, factor))


def _constant(text: str, number: Fraction, own: Unit | None) -> Value:
    try:
        base = float(number)
    except OverflowError:
        raise ExpressionError(f"{text} is beyond the range of a float") from None
    return Value(text, own, lambda rows: base, number=number, parts=("number", base))


def _product(text: str, a: Value, sign: str, b: Value) -> Value:
    """Return a product or a quotient; a bare number in it has no unit."""
    first, second = (one.unit or (NONE if one.number is not None else None) for one in (a, b))
    own = None
    if first and second and not (a.unit is None and b.unit is None):
        own = first if b.unit is None else first * second if sign == "*" else first / second
        own = second if a.unit is None and sign == "*" else own
    if a.number is not None and b.number is not None:
        if sign == "/" and not b.number:
            raise ExpressionError(f"{text} divides by 0")
        return _constant(text, a.number * b.number if sign == "*" else a.number / b.number, own)
    act = np.multiply if sign == "*" else np.divide

    def at(rows: Rows) -> Any:
        with np.errstate(all="ignore"):
            return act(a.at(rows), b.at(rows))

    return Value(text, own, at, a.names | b.names, parts=(act.__name__, a, b))


def _combination(text: str, act: Any, a: Value, b: Value) -> Value:
    """Return what two values of the same unit give: their sum, difference, minimum, maximum."""
    a, b = _in_one_unit(a, b, text)
    if a.number is not None and b.number is not None and act in _EXACT:
        return _constant(text, _EXACT[act](a.number, b.number), a.unit)

    def at(rows: Rows) -> Any:
        with np.errstate(all="ignore"):
            return act(a.at(rows), b.at(rows))

    return Value(text, a.unit, at, a.names | b.names, parts=(act.__name__, a, b))


def _in_one_unit(a: Value, b: Value, text: str) -> tuple[Value, Value]:
    """Return two values of the same unit; ExpressionError."""
    a, b = a.taken_as(b.unit), b.taken_as(a.unit)
    if a.unit is not None and b.unit is not None and a.unit.powers != b.unit.powers:
        units = (f"{one.text} is in {one.unit.text or '1'!r}" for one in (a, b) if one.unit)
        raise ExpressionError(f"{text}: {', '.join(units)}; take values of the same unit")
    return a, b


def _junction(found: list[Condition], word: str) -> Condition:
    """Return what holds where all hold, or any."""
    if len(found) == 1:
        return found[0]
    pick, where, other = _WORD[word]

    def margin(rows: Rows) -> Vector:
        return np.asarray(pick.reduce([one.margin(rows) for one in found]))

    def said(rows: Rows, i: int) -> Comparison:
        decided = int(where([one.margin(rows)[i] for one in found]))
        return found[decided].said(rows, i)

    text = f" {word} ".join(one.text for one in found)
    names = frozenset[str]().union(*(one.names for one in found))
    return Condition(
        text,
        names,
        margin,
        said,
        lambda: _junction([one.inverse() for one in found], other),
        (word, *found),
    )


def _rate(rows: Rows, found: Any) -> Vector:
    """Return the change since the recorded cycle before, a second; 0 in the first one."""
    values = np.broadcast_to(np.asarray(found, np.float64), len(rows))
    with np.errstate(all="ignore"):
        change = np.diff(values) / (np.diff(rows.cycle) * rows.period_s)
    return np.concatenate((np.zeros(min(len(rows), 1)), change))


def _root(rows: Rows, found: Any) -> Any:
    with np.errstate(invalid="ignore"):
        return np.sqrt(found)


_FUNCTIONS: dict[str, tuple[Callable[[Rows, Any], Any], Callable[[Unit], Unit]]] = {
    "abs": (lambda rows, found: np.abs(found), lambda own: own),
    "sqrt": (_root, lambda own: own.to_the(Fraction(1, 2))),
    "rate": (_rate, lambda own: own.a_second()),
}
_WORD: dict[str, tuple[Any, Any, str]] = {
    "and": (np.minimum, np.argmin, "or"),
    "or": (np.maximum, np.argmax, "and"),
}
_EXACT: dict[Any, Any] = {
    np.add: operator.add, np.subtract: operator.sub, np.minimum: min, np.maximum: max,
}  # fmt: skip
