"""What keeps a step out of lanes, and what to write instead: told before a study is slow by it."""

import ast
from collections.abc import Iterator

from pcpc.drivers.compiled.jit import LOOP_INTERPRETED
from pcpc.drivers.compiled.stage import Stage
from pcpc.executive.laws.block import Block
from pcpc.executive.own_laws.law_errors import cause
from pcpc.executive.own_laws.purity import has_decorator

_WHERE = "where(c, a, b)"


def lanes_problem(block: Block) -> str:
    """Return why runs of a block are done one by one, with place and cure; "" if they are not."""
    if LOOP_INTERPRETED or not isinstance(block.step, Stage):
        return ""
    try:
        _ = block.step.entry_of_lanes
    except Exception as error:  # numba has many
        return f"{cause(error)}: a sweep runs it one by one"
    return ""


def decisions(source: str) -> list[tuple[int, str]]:
    """Return line and words for what the steps of a law decide by their states or inputs.

    Eight runs decide it as one, or are done one by one. What depends on parameters may stay.
    """
    steps = (one for one in ast.parse(source).body if has_decorator(one, "stage"))
    decided = {
        each for step in steps if isinstance(step, ast.FunctionDef) for each in _decisions(step)
    }
    return [
        (line, f"`{word}` of a state or an input: runs that differ in it go one by one; {cure}")
        for line, word, cure in sorted(decided)
    ]


def _decisions(step: ast.FunctionDef) -> Iterator[tuple[int, str, str]]:
    """Yield line, word and cure."""
    vary = _varying_names(step)
    for node in ast.walk(step):
        if isinstance(node, ast.If | ast.IfExp | ast.While) and _mentions(node.test, vary):
            word = "while" if isinstance(node, ast.While) else "if"
            yield node.lineno, word, f"write {_WHERE}"
        elif isinstance(node, ast.BoolOp) and any(_mentions(v, vary) for v in node.values[:-1]):
            word, sign = ("and", "&") if isinstance(node.op, ast.And) else ("or", "|")
            yield node.lineno, word, f"write (a > b) {sign} (c > d)"
        elif isinstance(node, ast.Compare) and len(node.ops) > 1 and _mentions(node, vary):
            yield node.lineno, "a < b < c", "write (a < b) & (b < c)"
        elif isinstance(node, ast.Call) and _is_call(node, "int") and _mentions(node, vary):
            yield node.lineno, "int", "write floor(x) of emath where it is no place in an array"


def _varying_names(step: ast.FunctionDef) -> set[str]:
    """Return the names of states, inputs, outputs, and of all that is made of them."""
    names, before = {one.arg for one in step.args.args[3:]}, -1
    while len(names) != before:
        before = len(names)
        for node in ast.walk(step):
            if isinstance(node, ast.Assign | ast.AugAssign | ast.AnnAssign) and node.value:
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                if _mentions(node.value, names):
                    names |= {n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)}
    return names


def _mentions(node: ast.AST, names: set[str]) -> bool:
    """Return whether a value of one of the names is in it; a length is none."""
    if _is_call(node, "len"):
        return False
    if isinstance(node, ast.Name):
        return node.id in names
    return any(_mentions(one, names) for one in ast.iter_child_nodes(node))


def _is_call(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name
