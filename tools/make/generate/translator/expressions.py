"""Expressions of a step in C.

Python evaluates from left to right; in C the order within an expression is open. So a call that
changes memory becomes a statement of its own before, and what Python evaluated earlier is kept in
constants before that. Operators keep their order and their parentheses: no bit depends on them.
"""

import ast
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from pcpc.tools.make.generate.translator.kinds import (
    FLOAT,
    TRUTH,
    WHOLE,
    Callee,
    CellsKind,
    Kind,
    Number,
    Several,
    Untranslatable,
    Value,
    View,
    c_name,
    common_kind,
    number_text,
)
from pcpc.tools.make.generate.translator.source import File, Meaning, is_function, python_function

_LEVELS = {ast.Add: (12, "+"), ast.Sub: (12, "-"), ast.Mult: (13, "*"), ast.Div: (13, "/")}
_COMPARED = {
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
_PLAIN_FLOAT = re.compile(r"[0-9]+\.[0-9]*(e[+-]?[0-9]+)?|[0-9]+e[+-]?[0-9]+")
_LITERAL = re.compile(r"-?[0-9][0-9.e+-]*|true|false")
UNARY, PRIMARY = 14, 15


class Expressions:
    """Translates the expressions of one function; `unit` is the C file that it becomes part of."""

    def __init__(self, unit: Any, file: File, meaning: Meaning) -> None:
        self.unit, self.file, self.meaning = unit, file, meaning
        self.kinds: dict[str, Kind] = {}
        self.roots: dict[str, str] = {}  # of an alias: the variable that it is part of
        self.written: set[str] = set()
        self.lines: list[str] = []
        self.counted: set[str] = set()  # loop variables that cannot be negative
        self._kept = 0

    def error(self, node: ast.AST, what: str) -> Untranslatable:
        """Return an error at a place of the source."""
        return Untranslatable(f"{self.file.shown}:{getattr(node, 'lineno', 0)}: {what}")

    def number(self, node: ast.expr) -> Value:
        """Return a value that is one number. Raises Untranslatable."""
        value = self.value(node)
        if not isinstance(value.kind, Number):
            said = ast.unparse(node)
            raise self.error(node, f"{said} is not a number; name the part that you mean")
        return value

    def truth(self, node: ast.expr) -> Value:
        """Return a condition. Raises Untranslatable."""
        value = self.number(node)
        if value.kind != TRUTH:
            raise self.error(node, f"{ast.unparse(node)} is no comparison; write one, as `> 0.5`")
        return value

    def value(self, node: ast.expr) -> Value:
        """Return any expression. Raises Untranslatable."""
        made = getattr(self, f"_{type(node).__name__.lower()}", None)
        if made is None:
            what = f"{type(node).__name__} has no meaning in C: {ast.unparse(node)}"
            raise self.error(node, f"{what}; write it with numbers, ports and loops")
        found: Value = made(node)
        return found

    def operands(self, nodes: Sequence[ast.expr]) -> list[Value]:
        """Return values in Python's order of evaluation."""
        found: list[Value] = []
        for node in nodes:
            before = len(self.lines)
            value = self.value(node)
            if len(self.lines) > before:
                moved = self.lines[before:]
                del self.lines[before:]
                found = [self.kept(one) for one in found]
                self.lines += moved
            found.append(value)
        return found

    def kept(self, value: Value, name: str = "before", copy: bool = False) -> Value:
        """Return the value as a constant of this place; `copy`: even if no call can change it."""
        if (
            (value.fixed and not copy)
            or _LITERAL.fullmatch(value.text)
            or not isinstance(value.kind, Number)
        ):
            return value
        self._kept += 1
        its = f"{name}_{self._kept}"
        self.lines.append(f"const {value.kind.name} {its} = {value.text};")
        return Value(its, value.kind, fixed=True)

    def fresh(self, name: str) -> str:
        """Return the name of a further local variable."""
        self._kept += 1
        return f"{name}_{self._kept}"

    def apart(self, node: ast.expr, why: str) -> Value:
        """Return a value that needs no statement before it. Raises Untranslatable."""
        before = len(self.lines)
        value = self.number(node)
        if len(self.lines) > before:
            what = f"a call that changes states or returns several values {why}"
            raise self.error(node, f"{what}; give it a line of its own before")
        return value

    def _constant(self, node: ast.Constant) -> Value:
        value = node.value
        if isinstance(value, bool):
            return Value("true" if value else "false", TRUTH, fixed=True)
        if isinstance(value, int):
            if abs(value) >= 2**31:
                return Value(number_text(float(value)), FLOAT, fixed=True)
            return Value(str(value), WHOLE, fixed=True)
        if isinstance(value, float):
            said = self.file.said_by(node)
            text = said if _PLAIN_FLOAT.fullmatch(said) else number_text(value)
            return Value(text, FLOAT, fixed=True)
        raise self.error(node, f"{value!r} is no number")

    def _name(self, node: ast.Name) -> Value:
        if node.id in self.kinds:
            kind = self.kinds[node.id]
            root = node.id if isinstance(kind, View | CellsKind) else ""
            return Value(c_name(node.id), kind, root=root, fixed=isinstance(kind, Number))
        return self._global(node, node.id)

    def _global(self, node: ast.expr, name: str) -> Value:
        found = self.meaning.of(node)
        if is_function(found):
            return Value("", Callee(python_function(found)))
        if isinstance(found, bool | int | float | np.number | np.bool_):
            text, kind = self.unit.constant(name, found)
            return Value(text, kind, fixed=True)
        if isinstance(found, tuple | np.ndarray) and len(found):
            text, cells = self.unit.table(name, found)
            return Value(text, cells, fixed=True)
        raise self.error(node, f"{ast.unparse(node)} is unknown here; use ports and constants")

    def _attribute(self, node: ast.Attribute) -> Value:
        if self._global_part(node):
            return self._global(node, node.attr)
        base = self.value(node.value)
        if not isinstance(base.kind, View):
            raise self.error(node, f"{ast.unparse(node)}: only ports have names behind a point")
        field = base.kind.layout.field(node.attr)
        if field is None:
            known = ", ".join(one.name for one in base.kind.layout.fields[:8])
            raise self.error(node, f"no port {node.attr}; known: {known}")
        text = f"{base.text}{'->' if base.pointer else '.'}{c_name(field.name)}"
        if field.group is not None:
            return Value(text, View(field.group), root=base.root, pointer=False)
        kind: Kind = CellsKind(field.shape) if field.shape else FLOAT
        return Value(text, kind, root=base.root)

    def _global_part(self, node: ast.Attribute) -> bool:
        base: ast.expr = node
        while isinstance(base, ast.Attribute):
            base = base.value
        local = isinstance(base, ast.Name) and base.id in self.kinds
        return not local and self.meaning.of(node) is not None

    def _subscript(self, node: ast.Subscript) -> Value:
        base = self.value(node.value)
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if isinstance(base.kind, Several):
            outs = self._call_for(base, node)
            at = getattr(parts[0], "value", None)
            if not isinstance(at, int) or not 0 <= at < len(outs):
                raise self.error(node, "say which of the values by a number")
            return outs[at]
        if not isinstance(base.kind, CellsKind) or len(parts) > len(base.kind.shape):
            raise self.error(node, f"{ast.unparse(node)}: that has no such elements")
        indices = self.operands(parts)
        for part, index in zip(parts, indices, strict=True):
            if index.kind != WHOLE:
                raise self.error(part, f"the index {ast.unparse(part)} is no int; write int(...)")
            if index.text.startswith("-"):
                raise self.error(part, "count from the beginning: C has no index below 0")
        text = base.at(PRIMARY) + "".join(f"[{index.text}]" for index in indices)
        rest = base.kind.shape[len(parts) :]
        kind: Kind = CellsKind(rest, base.kind.element) if rest else base.kind.element
        return Value(text, kind, root=base.root)

    def _binop(self, node: ast.BinOp) -> Value:
        left, right = self.operands([node.left, node.right])
        fixed = left.fixed and right.fixed
        if isinstance(node.op, ast.BitAnd | ast.BitOr) and left.kind == right.kind == TRUTH:
            return self._both("&&" if isinstance(node.op, ast.BitAnd) else "||", [left, right])
        for side, value in ((node.left, left), (node.right, right)):
            if value.kind not in (WHOLE, FLOAT):
                raise self.error(side, f"{ast.unparse(side)} is no number to calculate with")
        kind = common_kind(left.kind, right.kind)
        if isinstance(node.op, ast.FloorDiv | ast.Mod):
            return self._whole(node, left, right)
        if type(node.op) not in _LEVELS:
            cure = "x * x" if isinstance(node.op, ast.Pow) else "+, -, * or /"
            raise self.error(node, f"{ast.unparse(node)}: write it with {cure}")
        level, sign = _LEVELS[type(node.op)]
        if sign == "/" and kind == WHOLE:
            kind, left = FLOAT, Value(f"(double){left.at(UNARY)}", FLOAT, UNARY)
        left, right = as_kind(left, kind), as_kind(right, kind)
        text = f"{left.at(level)} {sign} {right.at(level + 1)}"
        return Value(text, kind, level, fixed=fixed)

    def _whole(self, node: ast.BinOp, left: Value, right: Value) -> Value:
        """Return // or % of whole numbers that are not negative, where C means the same."""
        positive = isinstance(node.right, ast.Constant) and isinstance(node.right.value, int)
        counted = isinstance(node.left, ast.Name) and node.left.id in self.counted
        if left.kind != WHOLE or right.kind != WHOLE or not positive or not counted:
            said = ast.unparse(node)
            raise self.error(node, f"{said}: only of a loop's counter by a number; use floor()")
        sign = "/" if isinstance(node.op, ast.FloorDiv) else "%"
        return Value(f"{left.at(13)} {sign} {right.at(PRIMARY)}", WHOLE, 13, fixed=True)

    def _unaryop(self, node: ast.UnaryOp) -> Value:
        inner = self.number(node.operand)
        if isinstance(node.op, ast.Not):
            inner = self.truth(node.operand)
            return Value(f"!{inner.at(PRIMARY)}", TRUTH, UNARY, fixed=inner.fixed)
        if inner.kind == TRUTH or isinstance(node.op, ast.Invert):
            raise self.error(node, f"{ast.unparse(node)}: write `not`")
        sign = "-" if isinstance(node.op, ast.USub) else "+"
        return Value(f"{sign}{inner.at(PRIMARY)}", inner.kind, UNARY, fixed=inner.fixed)

    def _compare(self, node: ast.Compare) -> Value:
        values = self.operands([node.left, *node.comparators])
        for value in values:
            if value.kind not in (WHOLE, FLOAT):
                raise self.error(node, f"{ast.unparse(node)}: compare numbers")
        parts = []
        for a, op, b in zip(values, node.ops, values[1:], strict=False):
            if type(op) not in _COMPARED:
                raise self.error(node, f"{ast.unparse(node)}: compare with <, <=, ==, != >= or >")
            a, b = (as_kind(one, common_kind(a.kind, b.kind)) for one in (a, b))
            text = f"{a.at(11)} {_COMPARED[type(op)]} {b.at(11)}"
            parts.append(Value(text, TRUTH, 9, fixed=a.fixed and b.fixed))
        return parts[0] if len(parts) == 1 else self._both("&&", parts)

    def _both(self, sign: str, parts: Sequence[Value]) -> Value:
        text = f" {sign} ".join(part.at(UNARY) for part in parts)
        return Value(text, TRUTH, 5, fixed=all(part.fixed for part in parts))

    def _boolop(self, node: ast.BoolOp) -> Value:
        first = self.truth(node.values[0])
        rest = [self.apart(one, "behind `and` or `or`") for one in node.values[1:]]
        if any(one.kind != TRUTH for one in rest):
            raise self.error(node, f"{ast.unparse(node)}: write comparisons")
        return self._both("&&" if isinstance(node.op, ast.And) else "||", [first, *rest])

    def _ifexp(self, node: ast.IfExp) -> Value:
        condition = self.truth(node.test)
        arms = [self.apart(one, "in one arm of `if ... else`") for one in (node.body, node.orelse)]
        return self._chosen(node, [condition, *arms])

    def _chosen(self, node: ast.AST, values: Sequence[Value]) -> Value:
        condition, a, b = values
        kind = common_kind(a.kind, b.kind)
        if condition.kind != TRUTH or not isinstance(kind, Number):
            raise self.error(node, "choose between two numbers by a comparison")
        a, b = as_kind(a, kind), as_kind(b, kind)
        text = f"{condition.at(UNARY)} ? {a.at(4)} : {b.at(4)}"
        return Value(text, kind, 3, fixed=all(one.fixed for one in values))

    def _call_for(self, call: Value, node: ast.AST) -> list[Value]:
        """Return the results of a call as variables of this place."""
        assert isinstance(call.kind, Several)
        stem = call.text.partition("(")[0].removeprefix("pcpc_")
        outs = [Value(self.fresh(stem), kind, fixed=True) for kind in call.kind.kinds]
        for out in outs:
            assert isinstance(out.kind, Number)
            self.lines.append(f"{out.kind.name} {out.text};")
        given = call.text if call.text.endswith("(") else f"{call.text}, "
        self.lines.append(given + ", ".join(f"&{out.text}" for out in outs) + ");")
        return outs

    def wrote(self, name: str) -> None:
        """Note that memory was written to through a variable."""
        while name and name not in self.written:
            self.written.add(name)
            name = self.roots.get(name, "")


def as_kind(value: Value, kind: Kind) -> Value:
    """Return a whole number that meets a float as one, but a literal as it is."""
    if kind != FLOAT or value.kind != WHOLE or _LITERAL.fullmatch(value.text):
        return value
    return Value(f"(double){value.at(UNARY)}", FLOAT, UNARY, fixed=value.fixed)
