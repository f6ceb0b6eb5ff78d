"""Where local variables are declared in C: as late and as far inside as they can be."""

import ast
from collections import defaultdict
from collections.abc import Sequence

from pcpc.tools.make.generate.translator.source import names


class Places:
    """Of each statement: the names declared before it, and those declared by it, with a value."""

    def __init__(self, body: Sequence[ast.stmt], given: set[str]) -> None:
        self.before: dict[int, list[str]] = defaultdict(list)
        self.by: dict[int, set[str]] = defaultdict(set)
        loops = {
            node.target.id
            for stmt in body
            for node in ast.walk(stmt)
            if isinstance(node, ast.For) and isinstance(node.target, ast.Name)
        }
        stored = [
            node.id
            for stmt in body
            for node in ast.walk(stmt)
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
        ]
        for name in dict.fromkeys(stored):
            if name not in given and name not in loops and name != "_":
                self._place(name, body)

    def _place(self, name: str, block: Sequence[ast.stmt]) -> None:
        mentions = [stmt for stmt in block if name in names(stmt)]
        inner = _inner(name, mentions[0]) if len(mentions) == 1 else None
        if inner is not None:
            self._place(name, inner)
        elif assigns(name, mentions[0]):
            self.by[id(mentions[0])].add(name)
        else:
            self.before[id(mentions[0])].append(name)


def _inner(name: str, stmt: ast.stmt) -> Sequence[ast.stmt] | None:
    """Return the only block of a statement that needs to know the name; None if it is not so."""
    if isinstance(stmt, ast.If):
        blocks = [b for b in (stmt.body, stmt.orelse) if any(name in names(s) for s in b)]
        return blocks[0] if len(blocks) == 1 and name not in names(stmt.test) else None
    if isinstance(stmt, ast.For | ast.While):
        head = stmt.iter if isinstance(stmt, ast.For) else stmt.test
        first = next((s for s in stmt.body if name in names(s)), None)
        if first is None or name in names(head) or _inner(name, first) is None:
            fresh = first is not None and assigns(name, first) and name not in names(head)
            return stmt.body if fresh else None
        return stmt.body if _fresh(name, first) else None
    return None


def _fresh(name: str, stmt: ast.stmt) -> bool:
    """Return whether a nested block gives the name a value before it uses it."""
    inner = _inner(name, stmt)
    first = next((s for s in inner or () if name in names(s)), None)
    return first is not None and (assigns(name, first) or _fresh(name, first))


def assigns(name: str, stmt: ast.stmt) -> bool:
    """Return whether a statement gives the name a value, without using it."""
    if isinstance(stmt, ast.AnnAssign):
        return isinstance(stmt.target, ast.Name) and stmt.target.id == name
    if not isinstance(stmt, ast.Assign) or name in names(stmt.value):
        return False
    for target in stmt.targets:
        parts = target.elts if isinstance(target, ast.Tuple) else [target]
        if any(isinstance(part, ast.Name) and part.id == name for part in parts):
            used = [part for part in parts if not isinstance(part, ast.Name)]
            return not any(name in names(part) for part in used)
    return False
