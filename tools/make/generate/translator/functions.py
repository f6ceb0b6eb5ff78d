"""A function of a law in C, for the kinds of arguments that it is called with."""

import ast
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pcpc.tools.make.generate.translator.kinds import (
    FLOAT,
    Callee,
    CellsKind,
    Kind,
    Number,
    Value,
    View,
    c_name,
)
from pcpc.tools.make.generate.translator.places import Places
from pcpc.tools.make.generate.translator.source import Meaning, comment, comment_text, source_of
from pcpc.tools.make.generate.translator.statements import Statements

_WORD = re.compile(r"\w+")
_ROUNDS = 6  # until the kinds of all local variables are known
INDENT = "    "


@dataclass(frozen=True)
class CFunction:
    """A function in C; `changes` says of each argument whether it is written to."""

    name: str
    kinds: tuple[Kind, ...]
    changes: tuple[bool, ...]
    results: tuple[Number, ...]
    lines: tuple[str, ...]
    head: str
    module: str

    def arguments(self, values: Sequence[Value]) -> list[str]:
        """Return the texts of a call's arguments."""
        found = []
        for value, kind, changes in zip(values, self.kinds, self.changes, strict=True):
            if isinstance(kind, Callee) or (isinstance(kind, View) and not kind.layout.fields):
                continue
            text = value.address() if isinstance(kind, View) else value.text
            if isinstance(kind, CellsKind) and len(kind.shape) > 1 and not changes:
                rest = "".join(f"[{extent}]" for extent in kind.shape[1:])
                text = f"(const {kind.element.name} (*){rest}){value.at(14)}"
            found.append(text)
        return found


class Function(Statements):
    """Translates one function."""

    def __init__(self, unit: Any, function: Callable[..., Any], kinds: Sequence[Kind]) -> None:
        file, self.node = source_of(function)
        super().__init__(unit, file, Meaning(function))
        arguments = self.node.args
        if arguments.vararg or arguments.kwarg or arguments.kwonlyargs:
            raise self.error(self.node, f"{self.node.name}: plain arguments only")
        self.given = [one.arg for one in (*arguments.posonlyargs, *arguments.args)]
        if len(self.given) != len(kinds):
            what = f"{self.node.name} takes {len(self.given)} arguments, got {len(kinds)}"
            raise self.error(self.node, what)
        self.module = function.__module__
        self._first = dict(zip(self.given, kinds, strict=True))
        self.kinds = dict(self._first)
        self.results: tuple[Kind, ...] = ()
        body = self.node.body
        has_doc = isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant)
        self.body = body[1:] if has_doc else body
        self.places = Places(self.body, set(self.given))
        self.result_names: list[str] = []

    def translation(self, name: str, head: str | None = None) -> CFunction:
        """Return the function in C; `head` instead of one made from the arguments."""
        for _ in range(_ROUNDS):
            before = dict(self.kinds), self.results, set(self.written)
            lines = self._once()
            if before == (self.kinds, self.results, self.written):
                break
        kinds = tuple(self.kinds[one] for one in self.given)
        changes = tuple(one in self.written for one in self.given)
        results = tuple(one for one in self.results if isinstance(one, Number))
        head = head or self._head(name, kinds, changes, results)
        doc = comment(ast.get_docstring(self.node) or f"{self.node.name}.")
        said = set(_WORD.findall("\n".join(lines)))
        unused = [
            f"{INDENT}(void){c_name(one)};"
            for one, kind in zip(self.given, kinds, strict=True)
            if c_name(one) not in said and not isinstance(kind, Callee) and not _nothing(kind)
        ]
        text = [*doc, head, "{", *unused, *lines, "}"]
        return CFunction(name, kinds, changes, results, tuple(text), head, self.module)

    def _once(self) -> list[str]:
        self._kept, self.lines = 0, []
        return self.block(self.body, self.node.lineno)

    def _head(
        self, name: str, kinds: Sequence[Kind], changes: Sequence[bool], results: Sequence[Number]
    ) -> str:
        parts = [
            self.declared(c_name(one), kind, changed)
            for one, kind, changed in zip(self.given, kinds, changes, strict=True)
            if not isinstance(kind, Callee) and not _nothing(kind)
        ]
        parts += [
            f"{kind.name} *{its}"
            for its, kind in zip(self.result_names, results, strict=True)
            if len(results) > 1
        ]
        gives = results[0].name if len(results) == 1 else "void"
        return f"static {gives} {name}({', '.join(parts) or 'void'})"

    def declared(self, name: str, kind: Kind, changed: bool) -> str:
        """Return the declaration of an argument or an alias."""
        const = "" if changed else "const "
        if isinstance(kind, View):
            return f"{const}{self.unit.struct(kind.layout)} *{name}"
        if isinstance(kind, CellsKind):
            rest = "".join(f"[{extent}]" for extent in kind.shape[1:])
            its = f"(*{name}){rest}" if rest else f"*{name}"
            return f"{const}{kind.element.name} {its}"
        assert isinstance(kind, Number)
        return f"{kind.name} {name}"

    def block(self, body: Sequence[ast.stmt], after: int) -> list[str]:
        """Return the lines of statements; comments behind line `after` belong to them."""
        found: list[str] = []
        for stmt in body:
            found += self._own_comments(after, stmt.lineno)
            outer, self.lines = self.lines, []
            for name in self.places.before.get(id(stmt), ()):
                kind = self.kinds.get(name)
                self.lines.append(f"{(kind or FLOAT).name} {c_name(name)};")  # type: ignore[union-attr]
            self.statement(stmt)
            lines, self.lines = self.lines, outer
            found += self._trailing(stmt, [f"{INDENT}{line}" for line in lines])
            after = stmt.end_lineno or stmt.lineno
        return found

    def _own_comments(self, after: int, line: int) -> list[str]:
        return [
            f"{INDENT}/* {comment_text(words)} */"
            for at, (words, own) in self.file.comments.items()
            if after < at < line and own
        ]

    def _trailing(self, stmt: ast.stmt, lines: list[str]) -> list[str]:
        """Put the comments of a statement's lines where the statement stands."""
        compound = isinstance(stmt, ast.If | ast.For | ast.While)
        last = stmt.lineno if compound else (stmt.end_lineno or stmt.lineno)
        words = [
            said
            for at, (said, own) in self.file.comments.items()
            if stmt.lineno <= at <= last and not own
        ]
        if words and lines:
            at = next((i for i, line in enumerate(lines) if line.endswith("{")), len(lines) - 1)
            at = at if compound else len(lines) - 1
            lines[at] += f" /* {comment_text('; '.join(words))} */"
        return lines


def _nothing(kind: Kind) -> bool:
    return isinstance(kind, View) and not kind.layout.fields
