"""Calls in a step: of the elementary functions, of Python's few that C has, of the law's own."""

import ast
import builtins
from typing import Any

from pcpc.executive.laws import emath
from pcpc.executive.laws.block import flat
from pcpc.tools.make.generate.translator.expressions import UNARY, Expressions, as_kind
from pcpc.tools.make.generate.translator.kinds import (
    FLOAT,
    TRUTH,
    WHOLE,
    Callee,
    CellsKind,
    Number,
    Several,
    Value,
    View,
    number_text,
    size,
)
from pcpc.tools.make.generate.translator.source import is_function, python_function

_ADVICE = {
    "min": "where(a < b, a, b)", "max": "where(a > b, a, b)", "round": "floor(x + 0.5)",
    "pow": "a product", "sum": "a loop", "print": "an output port", "open": "a parameter",
}  # fmt: skip


class Calls(Expressions):
    """Translates calls, too."""

    def _call(self, node: ast.Call) -> Value:
        function = self._callee(node)
        if node.keywords or any(isinstance(one, ast.Starred) for one in node.args):
            raise self.error(node, "give the arguments one by one, by their place")
        if function is flat:
            return self._flat(node)
        if getattr(builtins, getattr(function, "__name__", ""), None) is function:
            return self._builtin(node, function)
        if not is_function(function):
            raise self.error(node, f"{ast.unparse(node.func)}: no function that C could have")
        if python_function(function).__module__ == emath.__name__:
            return self._elementary(node, python_function(function))
        return self._own(node, python_function(function))

    def _callee(self, node: ast.Call) -> Any:
        if isinstance(node.func, ast.Name) and node.func.id in self.kinds:
            kind = self.kinds[node.func.id]
            return kind.function if isinstance(kind, Callee) else None
        return self.meaning.of(node.func)

    def _flat(self, node: ast.Call) -> Value:
        view = self.value(node.args[0])
        if not isinstance(view.kind, View):
            raise self.error(node, "flat() is of ports")
        count = size(view.kind.layout)
        const = "const " if view.root not in self.written else ""
        text = f"({const}double *){view.address()}"
        return Value(text, CellsKind((count,)), UNARY, root=view.root)

    def _builtin(self, node: ast.Call, function: Any) -> Value:
        name = function.__name__
        if name == "len":
            cells = self.value(node.args[0])
            if not isinstance(cells.kind, CellsKind):
                raise self.error(node, f"{ast.unparse(node)}: only an array has a length")
            return Value(str(cells.kind.shape[0]), WHOLE, fixed=True)
        if name not in ("abs", "int", "float", "bool") or len(node.args) != 1:
            cure = _ADVICE.get(name, "numbers, ports and loops")
            raise self.error(node, f"{name}() has no meaning in C; write {cure}")
        value = self.number(node.args[0])
        if name == "bool":
            return self.truth(node.args[0]) if value.kind != TRUTH else value
        if name == "abs":
            if value.kind != FLOAT:
                raise self.error(node, "abs() of a whole number; write abs(1.0 * n)")
            return Value(f"pcpc_abs({value.text})", FLOAT, fixed=value.fixed)
        wanted = WHOLE if name == "int" else FLOAT
        if value.kind == wanted:
            return value
        if wanted == WHOLE and value.kind == FLOAT:
            return Value(f"pcpc_whole({value.text})", WHOLE, fixed=value.fixed)
        return Value(f"({wanted.name}){value.at(UNARY)}", wanted, UNARY, fixed=value.fixed)

    def _elementary(self, node: ast.Call, function: Any) -> Value:
        values = self.operands(node.args)
        fixed = all(value.fixed for value in values)
        if function is emath.where:
            if len(values) != 3:
                raise self.error(node, "where(c, a, b)")
            return self._chosen(node, values)
        if any(value.kind not in (FLOAT, WHOLE) for value in values):
            raise self.error(node, f"{ast.unparse(node)}: expected numbers")
        name, results = self.unit.elementary(function)
        text = ", ".join(as_kind(value, FLOAT).text for value in values)
        if len(results) == 1:
            return Value(f"{name}({text})", results[0], fixed=fixed)
        return Value(f"{name}({text}", Several(results))

    def _own(self, node: ast.Call, function: Any) -> Value:
        values = [*self.operands(node.args), *self._missing(node, function)]
        called = self.unit.function(function, tuple(value.kind for value in values), self, node)
        arguments = called.arguments(values)
        for value, changes in zip(values, called.changes, strict=True):
            if changes and value.root:
                self.wrote(value.root)
        text = f"{called.name}({', '.join(arguments)}"
        if len(called.results) > 1:
            return Value(text, Several(called.results))
        if not called.results:
            return Value(text + ")", None)
        numbers = all(isinstance(value.kind, Number) for value in values)
        fixed = numbers and all(value.fixed for value in values)
        whole = Value(text + ")", called.results[0], fixed=fixed)
        if not any(called.changes):
            return whole
        return self.kept(whole, function.__name__.strip("_"))

    def _missing(self, node: ast.Call, function: Any) -> list[Value]:
        """Return the default values of the arguments that a call leaves out."""
        defaults = function.__defaults__ or ()
        left = function.__code__.co_argcount - len(node.args)
        if left <= 0:
            return []
        if left > len(defaults):
            raise self.error(node, f"{ast.unparse(node)}: {left} arguments are missing")
        given = defaults[-left:]
        if any(not isinstance(value, float) for value in given):
            raise self.error(node, f"{ast.unparse(node)}: defaults are floats; give all arguments")
        return [Value(number_text(value), FLOAT, fixed=True) for value in given]
