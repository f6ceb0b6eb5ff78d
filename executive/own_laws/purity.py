"""What in a law's source makes the bits of a step depend on the machine, by its syntax tree alone.

A libm rounds sin, exp and powers as it likes; a clock, a file or a text on the terminal is no
matter of a step. `executive.laws.emath` has functions with the same bits everywhere.
"""

import ast
from collections.abc import Iterator

MODULES = ("math", "numpy", "time", "random", "os")
NAMES = {*MODULES, "np", "open", "print"}
EXACT = {"pi", "e", "tau", "inf", "nan"}  # numbers of those modules: the same everywhere


def has_decorator(function: ast.stmt, *marks: str) -> bool:
    """Return whether this is a function with one of these decorators."""
    decorators = function.decorator_list if isinstance(function, ast.FunctionDef) else []
    return any(isinstance(d, ast.Name) and d.id in marks for d in decorators)


def impure_uses(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and name of what steps and their helpers use that they should not."""
    names = NAMES | {*_imported_names(tree)}
    for node in (n for f in tree.body if has_decorator(f, "stage", "inline") for n in ast.walk(f)):
        if isinstance(node, ast.Name) and node.id in names:
            yield node.lineno, node.id
        if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.Pow):
            yield node.lineno, "**"


def warnings(source: str) -> list[tuple[int, str]]:
    """Return line and words for each such use in a law; numbers as `math.pi` may stay."""
    tree = ast.parse(source)
    exact = {
        (node.lineno, node.value.id)
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr in EXACT
        and isinstance(node.value, ast.Name)
    }
    return [(line, name) for line, name in sorted(set(impure_uses(tree)) - exact)]


def _imported_names(tree: ast.Module) -> Iterator[str]:
    """Yield the names under which a file imports those modules, or anything of them."""
    for node in tree.body:
        if isinstance(node, ast.Import):
            yield from (a.asname or a.name for a in node.names if a.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module in MODULES:
            yield from (a.asname or a.name for a in node.names if a.name not in EXACT)
