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

from pcpc.executive.laws.units import AFTER_NUMBER, NONE, Unit, unit

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
_ARITHMETIC: dict[type, str] = {
    ast.Add: "add", ast.Sub: "subtract", ast.Mult: "multiply", ast.Div: "divide",
}  # fmt: skip
_COMPARED: dict[type, str] = {
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
_FUNCTIONS = {
    "abs": "absolute", "sqrt": "sqrt", "rate": "rate", "min": "minimum", "max": "maximum",
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
class ComparedValue:
    """A comparison at one cycle: what was compared, its value and limit, in `unit`."""

    what: str
    value: float
    limit: float
    unit: Unit


@dataclass(frozen=True)
class Term:
    """A part of an expression, as data: what is done, `op`, with what, `of`, in which unit.

    `of`: parts, but the name and the factor of a `column`, and a `number` in base units.
    """

    op: str
    of: tuple[Any, ...]
    unit: Unit | None
    text: str

    @property
    def names(self) -> frozenset[str]:
        """The variables that it is about."""
        if self.op == "column":
            return frozenset(self.of[:1])
        parts = (part.names for part in self.of if isinstance(part, Term))
        return frozenset[str]().union(*parts)


class Value(Term):
    """A number a cycle, in base units; `unit` None adapts to what it stands beside.

    `op` is a function of numpy, or of `_FROM_ROWS`.
    """

    @property
    def number(self) -> Fraction | None:
        """The number of a constant, in base units."""
        return self.of[0] if self.op == "number" else None

    def at(self, rows: Rows) -> Any:
        """Return its value of each row, or of all."""
        arguments = [part.at(rows) if isinstance(part, Value) else part for part in self.of]
        with np.errstate(all="ignore"):
            if self.op in _FROM_ROWS:
                return _FROM_ROWS[self.op](rows, *arguments)
            return _ELEMENTWISE[self.op](*arguments)

    def taken_as(self, other: Unit | None) -> "Value":
        """Return a bare number, or a value of unknown unit, in the unit of its neighbour."""
        if self.unit is not None or other is None:
            return self
        if self.number is not None:
            return _constant(self.text, self.number * other.factor, other)
        return Value("multiply", (self, _constant("", other.factor, None)), other, self.text)


class Condition(Term):
    """What holds or not in a cycle: a sign between two values, or `and`, `or` of conditions.

    `unit`: in which a comparison is told.
    """

    @property
    def sides(self) -> tuple[Value, Value]:
        """The value that a comparison is about, and its limit."""
        a, b = self.of
        return (b, a) if a.number is not None else (a, b)

    def margin(self, rows: Rows) -> Vector:
        """Return the margin of each row; negative exactly where it does not hold."""
        if self.op in _JUNCTIONS:
            pick, _ = _JUNCTIONS[self.op]
            return np.asarray(pick.reduce([part.margin(rows) for part in self.of]))
        x, y, _ = np.broadcast_arrays(*(side.at(rows) for side in self.of), rows.cycle)
        with np.errstate(invalid="ignore", over="ignore"):
            held, far = _HOLDS[self.op](x, y), np.abs(x - y)
        far = np.where(np.isnan(far), 0.0, far)  # of equal infinities
        margin = np.where(held, 0.0 if self.op == "==" else far, np.minimum(-far, BARELY))
        return np.where(np.isnan(x) | np.isnan(y), -np.inf, margin)

    def said(self, rows: Rows, i: int) -> ComparedValue:
        """Return the comparison that decided in row i."""
        if self.op in _JUNCTIONS:
            _, decisive = _JUNCTIONS[self.op]
            part: Condition = self.of[int(decisive([part.margin(rows)[i] for part in self.of]))]
            return part.said(rows, i)
        x, y = (np.broadcast_to(side.at(rows), len(rows))[i] for side in self.sides)
        shown = self.unit or NONE
        factor = float(shown.factor)
        return ComparedValue(self.sides[0].text, float(x) / factor, float(y) / factor, shown)

    def inverse(self) -> "Condition":
        """Return what holds where this does not; NaN apart, where neither does."""
        opposite = _OPPOSITE[self.op]
        if opposite in _JUNCTIONS:
            return _junction([part.inverse() for part in self.of], opposite)
        return comparison(self.of[0], opposite, self.of[1])


def condition(text: str, units: Units) -> Condition:
    """Return the condition that a text states; ExpressionError."""
    parsed = _Reader(text, units).whole()
    if isinstance(parsed, Value):
        raise ExpressionError(f"{text} is a value; expected a condition, like {parsed.text} > 0")
    return parsed


def value(text: str, units: Units) -> Value:
    """Return the value that a text states; ExpressionError."""
    parsed = _Reader(text, units).whole()
    if isinstance(parsed, Condition):
        raise ExpressionError(f"{text} is a condition; expected a value")
    return parsed


def comparison(a: Value, sign: str, b: Value) -> Condition:
    """Return a comparison; ExpressionError for different units."""
    text = f"{a.text} {sign} {b.text}"
    a, b = _in_one_unit(a, b, text)
    first, last = (b, a) if a.number is not None else (a, b)
    return Condition(sign, (a, b), first.unit or last.unit or NONE, text)


def column(name: str, unit: Unit | None, factor: float = 1.0, text: str = "") -> Value:
    """Return the value of a column of the rows, which times `factor` is in base units."""
    return Value("column", (name, factor), unit, text or name)


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

    def _put_away(self, token: re.Match[str]) -> str:
        if (name := token["name"]) in _WORDS:
            return token[0]
        if name:
            known = self.units(name)
            self.operands.append(column(name, known, 1.0 if known is None else float(known.factor)))
        else:
            known = unit(token["unit"].strip()) if token["unit"] else None
            number = Fraction(token["number"]) * (known.factor if known else 1)
            self.operands.append(_constant(token[0], number, known))
        return f"_{len(self.operands) - 1}_"

    def read(self, node: ast.AST) -> Value | Condition:
        """Return what a part of the tree stands for."""
        text = ast.get_source_segment(self.prepared, node) or ""
        text = _PLACEHOLDER.sub(lambda mark: self.operands[int(mark[1])].text, text)
        match node:
            case ast.Name(id=name) if mark := _PLACEHOLDER.fullmatch(name):
                return self.operands[int(mark[1])]
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return self._condition(operand).inverse()
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self._value(operand)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                minus = _constant("-1", Fraction(-1), None)
                return _product(text, "multiply", minus, self._value(operand))
            case ast.BinOp(left=a, op=op, right=b) if word := _ARITHMETIC.get(type(op)):
                made = _combination if word in ("add", "subtract") else _product
                return made(text, word, self._value(a), self._value(b))
            case ast.Compare(left=a, ops=ops, comparators=more) if all(
                type(op) in _COMPARED for op in ops
            ):
                sides = pairwise([self._value(side) for side in (a, *more)])
                signs = [_COMPARED[type(op)] for op in ops]
                return _junction(
                    [comparison(x, sign, y) for sign, (x, y) in zip(signs, sides, strict=True)],
                    "and",
                )
            case ast.BoolOp(op=op, values=parts):
                word = "and" if isinstance(op, ast.And) else "or"
                return _junction([self._condition(part) for part in parts], word)
            case ast.Call(func=ast.Name(id=name), args=given, keywords=[]):
                return self._call(text, name, [self._value(argument) for argument in given])
        known = "names, numbers, + - * /, comparisons, and or not, abs min max sqrt rate"
        raise self.wrong(f"is more than {known}")

    def _value(self, node: ast.AST) -> Value:
        part = self.read(node)
        if isinstance(part, Condition):
            raise self.wrong(f"calculates with the condition {part.text}")
        return part

    def _condition(self, node: ast.AST) -> Condition:
        part = self.read(node)
        if isinstance(part, Value):
            raise self.wrong(f"needs a condition for {part.text}, like {part.text} > 0")
        return part

    def _call(self, text: str, name: str, arguments: list[Value]) -> Value:
        op = _FUNCTIONS.get(name, "")
        if op in ("minimum", "maximum") and len(arguments) > 1:
            return reduce(lambda a, b: _combination(text, op, a, b), arguments)
        if op not in _UNIT_AFTER or len(arguments) != 1:
            raise self.wrong(
                "calls an unknown function; known: abs sqrt rate of one value, min max of several"
            )
        (argument,) = arguments
        return Value(op, (argument,), argument.unit and _UNIT_AFTER[op](argument.unit), text)


def _constant(text: str, number: Fraction, own_unit: Unit | None) -> Value:
    try:
        float(number)
    except OverflowError:
        raise ExpressionError(f"{text} is beyond the range of a float") from None
    return Value("number", (number,), own_unit, text)


def _product(text: str, op: str, a: Value, b: Value) -> Value:
    """Return a product or a quotient; a bare number in it has no unit."""
    first, second = (side.unit or (NONE if side.number is not None else None) for side in (a, b))
    both = None
    if first and second and not (a.unit is None and b.unit is None):
        both = first if b.unit is None else first * second if op == "multiply" else first / second
        both = second if a.unit is None and op == "multiply" else both
    return _folded(text, op, both, a, b)


def _combination(text: str, op: str, a: Value, b: Value) -> Value:
    """Return what two values of the same unit give: their sum, difference, minimum, maximum."""
    a, b = _in_one_unit(a, b, text)
    return _folded(text, op, a.unit, a, b)


def _folded(text: str, op: str, own_unit: Unit | None, a: Value, b: Value) -> Value:
    """Return what two values give, of two constants a constant."""
    if a.number is None or b.number is None:
        return Value(op, (a, b), own_unit, text)
    if op == "divide" and not b.number:
        raise ExpressionError(f"{text} divides by 0")
    return _constant(text, _EXACT[op](a.number, b.number), own_unit)


def _in_one_unit(a: Value, b: Value, text: str) -> tuple[Value, Value]:
    """Return two values of the same unit; ExpressionError."""
    a, b = a.taken_as(b.unit), b.taken_as(a.unit)
    if a.unit is not None and b.unit is not None and a.unit.powers != b.unit.powers:
        units = (f"{side.text} is in {side.unit.text or '1'!r}" for side in (a, b) if side.unit)
        raise ExpressionError(f"{text}: {', '.join(units)}; take values of the same unit")
    return a, b


def _junction(parts: list[Condition], word: str) -> Condition:
    """Return what holds where all hold, or any."""
    if len(parts) == 1:
        return parts[0]
    return Condition(word, tuple(parts), None, f" {word} ".join(part.text for part in parts))


def _rate(rows: Rows, given: Any) -> Vector:
    """Return the change since the recorded cycle before, a second; 0 in the first one."""
    values = np.broadcast_to(np.asarray(given, np.float64), len(rows))
    change = np.diff(values) / (np.diff(rows.cycle) * rows.period_s)
    return np.concatenate((np.zeros(min(len(rows), 1)), change))


def _column(rows: Rows, name: str, factor: float) -> Vector:
    return rows.columns[name] if factor == 1.0 else rows.columns[name] * factor


_FROM_ROWS: dict[str, Callable[..., Any]] = {
    "column": _column, "number": lambda rows, number: float(number), "rate": _rate,
}  # fmt: skip
_ELEMENTWISE: dict[str, Callable[..., Any]] = {
    "add": np.add, "subtract": np.subtract, "multiply": np.multiply, "divide": np.divide,
    "minimum": np.minimum, "maximum": np.maximum, "absolute": np.absolute, "sqrt": np.sqrt,
}  # fmt: skip
_EXACT: dict[str, Callable[..., Fraction]] = {  # of numbers
    "add": operator.add, "subtract": operator.sub, "multiply": operator.mul,
    "divide": operator.truediv, "minimum": min, "maximum": max,
}  # fmt: skip
_UNIT_AFTER: dict[str, Callable[[Unit], Unit]] = {
    "absolute": lambda own: own, "sqrt": lambda own: own.to_the(Fraction(1, 2)),
    "rate": lambda own: own.per_second(),
}  # fmt: skip
_HOLDS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq,
    "!=": operator.ne,
}  # fmt: skip
_JUNCTIONS: dict[str, tuple[Any, Any]] = {  # of margins: the whole, and which one decides
    "and": (np.minimum, np.argmin), "or": (np.maximum, np.argmax),
}  # fmt: skip
_OPPOSITE = {
    "<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "==", "and": "or", "or": "and",
}  # fmt: skip
