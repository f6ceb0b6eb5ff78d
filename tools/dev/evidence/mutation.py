"""Mutants of compiled functions: all in one copy of the code, of which a number chooses one.

    a < b        ->   (a <= b if _m[0] == 7 else a >= b if _m[0] == 8 else a < b)
    x[i] = y     ->   if _m[0] != 9: x[i] = y

`_m` is an array of one number, which every function of the copy takes first; 0 chooses none. What
is changed: comparisons (each other operator that is near), `and` for `or`, arithmetic and bit
operators, `min` for `max`, numbers by one, conditions negated, statements left out that write to
memory or call, entries of a table. In every mutant the rest of the code is as it was.
"""

import ast
import hashlib
import inspect
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from importlib import import_module, util
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import Any

from pcpc.drivers.compiled.compile_cache import cache_folder

_COMPARE: Mapping[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt), ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,),
}  # fmt: skip
_BINARY: Mapping[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.Div: ast.Mult, ast.FloorDiv: ast.Add,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitOr, ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}  # fmt: skip
_CALLS = {"min": "max", "max": "min"}
_COMPILED = """
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.structures import words
"""
_INTERPRETED = """
import numpy as np
def loop_function(function): return function
def data_of(frame): return frame[8:16]
def copy(target, source): target[:] = source
def words(structure): return np.asarray(structure).reshape(1).view(np.int64)
"""  # what cannot be called but by compiled functions


Driver = tuple[Callable[..., Any], str]  # a step that calls the copies, text that calls the step


@dataclass(frozen=True)
class Mutant:
    """One change: where, what stood there, what stands there instead."""

    number: int
    module: str
    function: str
    line: int
    source: str  # the line
    was: str
    becomes: str

    @property
    def change(self) -> str:
        """What is changed, wherever the line stands."""
        return f"{self.function}: {self.source}: {self.was} -> {self.becomes}"

    def __str__(self) -> str:
        file = self.module.replace(".", "/")
        return f"{file}.py:{self.line}: {self.change}"


class _Change(ast.NodeTransformer):
    """Puts the mutants of one function into its tree; `found` grows by them."""

    def __init__(
        self,
        module: str,
        function: str,
        source: ModuleType,
        lines: Sequence[str],
        first: int,
        targets: Sequence[str],
        tables: Mapping[str, tuple[int, ...]],
        found: list[Mutant],
    ) -> None:
        self._about, self._source = (module, function), source
        self._lines, self._first = lines, first
        self._targets, self._tables, self._found = targets, tables, found

    def _new(self, node: ast.AST, becomes: str) -> ast.expr:
        """Note a mutant; return the test that chooses it."""
        number = len(self._found) + 1
        line: int = node.lineno  # type: ignore[attr-defined]
        about = (*self._about, self._first + line - 1, self._lines[line - 1].strip(" :\n"))
        self._found.append(Mutant(number, *about, ast.unparse(node), becomes))
        return ast.parse(f"_m[0] == {number}", mode="eval").body

    def _or(self, node: ast.expr, instead: Sequence[ast.expr], changed: ast.expr) -> ast.expr:
        """Return the mutants of `node`, else what it is with those below it."""
        for other in instead:
            test = self._new(node, ast.unparse(other))
            changed = ast.IfExp(test, self._plain(other), changed)
        return changed

    def _plain(self, node: ast.expr) -> ast.expr:
        """Return a copy without mutants, whose calls are those of the copied functions."""
        copy = ast.parse(ast.unparse(node), mode="eval").body
        return _Calls(self._targets).visit(copy)

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """Swap the operator of a comparison; in a chain, of each."""
        instead: list[ast.expr] = []
        for i, operator in enumerate(node.ops):
            for other in _COMPARE.get(type(operator), ()):
                ops = [*node.ops[:i], other(), *node.ops[i + 1 :]]
                instead.append(ast.Compare(node.left, ops, node.comparators))
        copy = deepcopy(node)
        copy.left = self.visit(copy.left)
        for i, value in enumerate(node.comparators):
            if _is_number(value):
                more = ast.Constant(value.value + 1)  # type: ignore[attr-defined]
                others = [*node.comparators[:i], more, *node.comparators[i + 1 :]]
                instead.append(ast.Compare(node.left, node.ops, others))
            else:
                copy.comparators[i] = self.visit(copy.comparators[i])
        return self._or(node, instead, copy)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        """Swap `and` and `or`."""
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        instead = ast.BoolOp(other, node.values)
        return self._or(node, [instead], self.generic_visit(deepcopy(node)))  # type: ignore[arg-type]

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        """Take another operator."""
        other = _BINARY.get(type(node.op))
        instead: list[ast.expr] = [ast.BinOp(node.left, other(), node.right)] if other else []
        return self._or(node, instead, self.generic_visit(deepcopy(node)))  # type: ignore[arg-type]

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        """Take the other value."""
        instead = ast.IfExp(node.test, node.orelse, node.body)
        return self._or(node, [instead], self.generic_visit(deepcopy(node)))  # type: ignore[arg-type]

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        """Change a number by one."""
        if not _is_number(node):
            return node
        return self._or(node, [ast.Constant(node.value + 1)], node)  # type: ignore[operator]

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """Take min for max, and lead calls to the copies."""
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        instead = []
        if name in _CALLS:
            instead = [ast.Call(ast.Name(_CALLS[name], ast.Load()), node.args, [])]
        copy = deepcopy(node)
        copy.args = [self.visit(one) for one in copy.args]
        return self._or(node, instead, _switched_call(copy, self._targets))

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        """Change each entry of a table; nothing in other indices of names and numbers."""
        name = node.value.attr if isinstance(node.value, ast.Attribute) else ast.unparse(node.value)
        shape = self._tables.get(name)
        if shape is None or not isinstance(node.ctx, ast.Load):
            return self.generic_visit(node)  # type: ignore[return-value]
        index = (
            node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice, ast.Constant(0)]
        )
        row, column = map(ast.unparse, index)
        try:  # a column that stands there by its name
            columns = [int(eval(column, vars(self._source)))]
        except NameError:
            columns = [*range(shape[1])]
        first = len(self._found) + 1
        for at in product(range(shape[0]), columns):
            self._new(node, f"another entry in row {at[0]}, column {at[1]}")
        hit = f"_m[0] == {first} + ({row}) * {len(columns)} + ({column}) - {columns[0]}"
        text = f"(({ast.unparse(node)} + 1) % {shape[2]} if {hit} else {ast.unparse(node)})"
        return ast.parse(text, mode="eval").body

    def visit_If(self, node: ast.If) -> ast.stmt:
        """Negate a condition."""
        test = deepcopy(node.test)
        node.test = self._or(test, [ast.UnaryOp(ast.Not(), test)], self.visit(node.test))
        node.body = [one for old in node.body for one in _statements(self.visit(old))]
        node.orelse = [one for old in node.orelse for one in _statements(self.visit(old))]
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.stmt:
        """Leave out a store to memory; what a name holds changes with the value."""
        return self._left_out(node, all(isinstance(t, ast.Name | ast.Tuple) for t in node.targets))

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.stmt:
        """Leave it out."""
        return self._left_out(node, False)

    def visit_Expr(self, node: ast.Expr) -> ast.stmt:
        """Leave out a call; a docstring is none."""
        return self._left_out(node, isinstance(node.value, ast.Constant))

    def visit_Continue(self, node: ast.Continue) -> ast.stmt:
        """Leave it out."""
        return self._left_out(node, False)

    def _left_out(self, node: Any, stays: bool) -> ast.stmt:
        if isinstance(node, ast.Expr) and stays:
            return node
        test = None if stays else self._new(node, "nothing")
        if hasattr(node, "value"):
            node.value = self.visit(node.value)
        if test is None:
            return node
        return ast.If(ast.UnaryOp(ast.Not(), test), [node], [])


class _Calls(ast.NodeTransformer):
    """Leads calls to the copied functions."""

    def __init__(self, targets: Sequence[str]) -> None:
        self._targets = targets

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """Give `_m` to a copied function."""
        self.generic_visit(node)
        return _switched_call(node, self._targets)


def _switched_call(node: ast.Call, targets: Sequence[str]) -> ast.Call:
    name = getattr(node.func, "attr", getattr(node.func, "id", ""))
    if name not in targets:
        return node
    first = ast.Name("_m", ast.Load())
    return ast.Call(ast.Name(f"m_{name}", ast.Load()), [first, *node.args], node.keywords)


def _is_number(node: ast.expr) -> bool:
    value = getattr(node, "value", None)
    return isinstance(node, ast.Constant) and type(value) in (int, float)


def _statements(node: Any) -> Iterator[Any]:
    yield from node if isinstance(node, list) else [node]


def build(
    targets: Mapping[str, Sequence[str]],
    tables: Mapping[str, tuple[int, ...]],
    drivers: Mapping[str, Driver],
    beside: Mapping[str, Callable[[Any], None]],
    compiled: bool = True,
) -> tuple[list[Mutant], dict[str, Callable[..., None]]]:
    """Return all mutants of `targets` (functions by module), and what feeds them, by name.

    `tables`: rows, columns and number of values of arrays. `beside`: puts what else stands in a
    module's copy into it. Compiling all takes half a minute, for a few mutants they need not be.
    """
    found: list[Mutant] = []
    every = [name for names in targets.values() for name in names]
    texts: dict[str, str] = {}
    decorator = _COMPILED if compiled else _INTERPRETED

    def head(module: str) -> Iterator[str]:
        yield f"import {module} as _source"
        yield "globals().update({k: v for k, v in vars(_source).items() if k[:2] != '__'})"
        yield decorator
        for one in (one for one in texts if one in targets):
            yield f"from {_name(one)} import {', '.join(f'm_{name}' for name in targets[one])}"

    for module, names in targets.items():
        source = import_module(f"pcpc.{module}")
        parts = [_mutated_source(source, module, name, every, tables, found) for name in names]
        texts[module] = "\n".join([*head(source.__name__), *parts])
    for name, (step, text) in drivers.items():
        calls = _Calls([*every, step.__name__])
        tree = ast.parse(inspect.getsource(step) + text)
        for function in calls.visit(tree).body:
            _make_copy(function, f"m_{step.__name__}" if function.name == step.__name__ else "feed")
        texts[f"driver.{name}"] = "\n".join([*head(step.__module__), ast.unparse(tree)])
    others = {inspect.getfile(one) for one in (*beside.values(), *(a for a, _ in drivers.values()))}
    own = [Path(one).read_text() for one in sorted(others)]  # its constants
    mark = hashlib.sha256("".join([*texts.values(), *own]).encode()).hexdigest()[:16]
    folder = cache_folder() / "mutants" / mark  # what is compiled holds what it calls
    folder.mkdir(parents=True, exist_ok=True)
    for module, text in texts.items():
        file = folder / f"{_name(module)}.py"
        if not file.exists():
            file.write_text(text)
        loaded = _load(file)
        if module in beside:
            beside[module](loaded)
    return found, {name: sys.modules[_name(f"driver.{name}")].feed for name in drivers}


def _mutated_source(
    source: ModuleType,
    module: str,
    name: str,
    every: Sequence[str],
    tables: Mapping[str, tuple[int, ...]],
    found: list[Mutant],
) -> str:
    function = getattr(source, name)
    function = getattr(function, "py_func", function)
    lines, first = inspect.getsourcelines(function)
    tree: Any = ast.parse(textwrap.dedent("".join(lines))).body[0]
    tree.body = [
        one
        for old in tree.body
        for one in _statements(
            _Change(module, name, source, lines, first, every, tables, found).visit(old)
        )
    ]
    _make_copy(tree, f"m_{name}")
    return ast.unparse(ast.fix_missing_locations(tree))


def _make_copy(function: Any, name: str) -> None:
    """Have a function take `_m` first, compiled under another name."""
    if "_m" not in [one.arg for one in function.args.args]:
        function.args.args.insert(0, ast.arg("_m"))
    for argument in function.args.args:
        argument.annotation = None
    function.name, function.returns = name, None
    function.decorator_list = [ast.Name("loop_function", ast.Load())]


def _name(module: str) -> str:
    return f"mutants_of_{module.replace('.', '_')}"


def _load(file: Path) -> ModuleType:
    spec = util.spec_from_file_location(file.stem, file)
    assert spec is not None and spec.loader is not None
    module = util.module_from_spec(spec)
    sys.modules[file.stem] = module
    spec.loader.exec_module(module)
    return module
