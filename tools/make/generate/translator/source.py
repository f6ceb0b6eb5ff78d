"""The source of a step and of what it calls: syntax trees, comments, and what the names mean."""

import ast
import inspect
import io
import tokenize
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from pcpc.drivers.compiled.stage import Stage
from pcpc.executive.own_laws.modules import PROJECT
from pcpc.tools.make.generate.translator.kinds import Untranslatable

_NO_COMMENT = ("fmt:", "noqa", "type:", "pragma")


@dataclass(frozen=True)
class File:
    """A Python file: its tree, and its comments by line: text, whether it has a line of its own."""

    path: Path
    tree: ast.Module
    text: str
    comments: dict[int, tuple[str, bool]]

    @property
    def shown(self) -> str:
        """Return the path as messages and generated files show it."""
        return str(self.path.relative_to(PROJECT) if self._inside else self.path.name)

    def said_by(self, node: ast.Constant) -> str:
        """Return what the source says for a number, which is all in one line."""
        line = self._lines[node.lineno - 1].encode()
        return line[node.col_offset : node.end_col_offset].decode()

    @cached_property
    def _lines(self) -> list[str]:
        return self.text.split("\n")

    @property
    def _inside(self) -> bool:
        return self.path.is_relative_to(PROJECT)


def python_function(function: Any) -> Any:
    """Return the Python function under a decorator."""
    return getattr(function, "py_func", function)


def is_function(what: Any) -> bool:
    """Return whether this is a function whose source can be read."""
    return inspect.isfunction(python_function(what)) and not isinstance(what, Stage)


@cache
def read(path: Path) -> File:
    """Return a file with its comments."""
    text = path.read_text(encoding="utf-8")
    found: dict[int, tuple[str, bool]] = {}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            words = token.string.lstrip("# ").rstrip()
            if words and not words.startswith(_NO_COMMENT):
                found[token.start[0]] = words, not token.line[: token.start[1]].strip()
    return File(path, ast.parse(text), text, found)


def source_of(function: Callable[..., Any]) -> tuple[File, ast.FunctionDef]:
    """Return the file of a function and its tree; Untranslatable without a source."""
    code = function.__code__
    try:
        file = read(Path(code.co_filename).resolve())
    except OSError as error:
        what = f"{code.co_filename}: {function.__name__}: its source cannot be read"
        raise Untranslatable(what) from error
    for node in ast.walk(file.tree):
        if isinstance(node, ast.FunctionDef) and node.name == function.__name__:
            first = min([node.lineno, *(mark.lineno for mark in node.decorator_list)])
            if code.co_firstlineno in (first, node.lineno):
                return file, node
    raise Untranslatable(f"{file.shown}: no function {function.__name__} in the source")


class Meaning:
    """What the global names of a function stand for."""

    def __init__(self, function: Callable[..., Any]) -> None:
        closure = inspect.getclosurevars(function)
        self._names = {**closure.builtins, **closure.globals, **closure.nonlocals}
        self._names.update(zip(function.__code__.co_freevars, _cells(function), strict=True))

    def of(self, node: ast.expr) -> Any:
        """Return the object of a name or of a part of a module; None if it is neither."""
        if isinstance(node, ast.Name):
            return self._names.get(node.id)
        if isinstance(node, ast.Attribute):
            base = self.of(node.value)
            return getattr(base, node.attr, None) if inspect.ismodule(base) else None
        return None


def _cells(function: Callable[..., Any]) -> Iterator[Any]:
    for cell in function.__closure__ or ():
        yield cell.cell_contents


def names(node: ast.AST) -> set[str]:
    """Return all names that a tree mentions."""
    return {one.id for one in ast.walk(node) if isinstance(one, ast.Name)}


def comment_text(text: str) -> str:
    """Return a text that can stand in a comment of C."""
    return text.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")


def comment(text: str, indent: str = "") -> list[str]:
    """Return the lines of a comment."""
    lines = comment_text(inspect.cleandoc(text)).splitlines()
    if len(lines) == 1:
        return [f"{indent}/* {lines[0]} */"]
    rest = [f"{indent} * {line}".rstrip() for line in lines[1:]]
    return [f"{indent}/* {lines[0]}", *rest, f"{indent} */"]
