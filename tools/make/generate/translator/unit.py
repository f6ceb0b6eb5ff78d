"""One C file in the making: its structures, constants and functions, each once."""

import ast
import re
import sys
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pcpc.drivers.compiled.views import Field, Layout
from pcpc.executive.laws import emath
from pcpc.tools.make.generate.translator.functions import CFunction, Function
from pcpc.tools.make.generate.translator.kinds import (
    FLOAT,
    TRUTH,
    WHOLE,
    CellsKind,
    Kind,
    Number,
    Untranslatable,
    number_text,
)
from pcpc.tools.make.generate.translator.source import comment, source_of
from pcpc.tools.make.generate.words import identifier

COLUMNS = 100
ROLES = ("parameters", "states", "inputs", "outputs")


class Unit:
    """What the functions of one file share; `name` begins the names of its structures."""

    prefix = ""  # of its constants

    def __init__(self, name: str) -> None:
        self.name = name
        self.structs: dict[Layout, str] = {}
        self.constants: dict[str, tuple[Any, str]] = {}
        self.called: dict[tuple[Any, ...], CFunction] = {}
        self._names: set[str] = set()
        self._open: list[Any] = []

    def struct(self, layout: Layout) -> str:
        """Return the name of the structure of a layout. Raises Untranslatable."""
        if layout not in self.structs:
            raise Untranslatable(f"{self.name}: ports of {layout.name} that are no part of it")
        return self.structs[layout]

    def name_role(self, layout: Layout, role: str) -> None:
        """Name the structures of a role, those of its groups first."""
        for field in layout.fields:
            if field.group is not None and field.group not in self.structs:
                self.name_role(field.group, _group_name(field))
        if layout not in self.structs:
            self.structs[layout] = self._free(f"{self.name}_{role}")

    def constant(self, name: str, value: Any) -> tuple[str, Number]:
        """Return name and kind of a number from outside of the function."""
        if isinstance(value, bool | np.bool_):
            return self._constant_name(name, "bool", "", "true" if value else "false"), TRUTH
        if isinstance(value, int | np.integer) and abs(int(value)) < 2**31:
            return self._constant_name(name, "int32_t", "", str(int(value))), WHOLE
        text = number_text(float(value))
        return (text if "PCPC" in text else self._constant_name(name, "double", "", text)), FLOAT

    def table(self, name: str, values: Any) -> tuple[str, CellsKind]:
        """Return name and kind of an array from outside of the function. Raises Untranslatable."""
        array = np.asarray(values)
        element = TRUTH if array.dtype.kind == "b" else WHOLE if array.dtype.kind in "iu" else FLOAT
        if array.dtype.kind not in "biuf" or array.size == 0:
            raise Untranslatable(f"{self.name}: {name} is no array of numbers; make it one")
        shape = "".join(f"[{extent}]" for extent in array.shape)
        text = self._constant_name(name, element.name, shape, _initialiser(array))
        return text, CellsKind(tuple(array.shape), element)

    def _constant_name(self, name: str, kind: str, shape: str, text: str) -> str:
        its = self.prefix + name.lstrip("_")
        line = f"static const {kind} {{}}{shape} = {text};"
        for one in (its, *(f"{its}_{i}" for i in range(2, 100))):
            if one not in self.constants:
                self.constants[one] = (line, line.replace("{}", one, 1))
            if self.constants[one][0] == line:
                return one
        raise Untranslatable(f"{self.name}: too many constants named {name}")

    def elementary(self, function: Callable[..., Any]) -> tuple[str, tuple[Number, ...]]:
        """Return the name of an elementary function, and its results. Raises Untranslatable."""
        count = 2 if function.__name__ == "sincos" else 1
        if function.__name__.startswith("_") or getattr(emath, function.__name__, None) is None:
            raise Untranslatable(f"emath.{function.__name__} is not for laws; call a public one")
        return f"pcpc_{function.__name__}", (FLOAT,) * count

    def function(
        self, function: Callable[..., Any], kinds: tuple[Kind, ...], caller: Any, node: ast.AST
    ) -> CFunction:
        """Return a function for these kinds of arguments. Raises Untranslatable."""
        key = (function, kinds)
        if key in self._open:
            raise caller.error(node, f"{function.__name__} calls itself; write a loop")
        if key not in self.called:
            self._open.append(key)
            made = Function(self, function, kinds)
            self.called[key] = made.translation(self._free(self._function_name(function)))
            self._open.remove(key)
        return self.called[key]

    def _function_name(self, function: Callable[..., Any]) -> str:
        file, _ = source_of(function)
        name = function.__name__.strip("_")
        stem = file.path.stem
        stem = identifier(file.path.parent.name if stem == "model" else stem)
        return name if name.startswith(f"{stem}_") else f"{stem}_{name}"

    def _free(self, name: str) -> str:
        names = (name, *(f"{name}_{i}" for i in range(2, 1000)))
        found = next(one for one in names if one not in self._names)
        self._names.add(found)
        return found

    def reserve(self, *names: str) -> None:
        """Keep names for what the file defines beside functions."""
        self._names.update(names)

    def constant_lines(self) -> list[str]:
        """Return the definitions of the constants."""
        return [line for _, text in self.constants.values() for line in wrapped_lines(text)]

    def function_lines(self, seen: Sequence[str]) -> list[str]:
        """Return the functions in order, each module's header before its first one."""
        found: list[str] = []
        known = set(seen)
        for called in self.called.values():
            if called.module not in known:
                known.add(called.module)
                found += [*module_comment(called.module), ""]
            found += [*(part for line in called.lines for part in wrapped_lines(line)), ""]
        return found


def _group_name(field: Field) -> str:
    """Return the name of a group's structure: its class, or its place if that says more."""
    assert field.group is not None
    name = snake(field.group.name)
    return f"{field.name}_{name}" if name in ROLES else name


def module_comment(module: str) -> list[str]:
    """Return the header of a Python module as a comment."""
    doc = getattr(sys.modules.get(module), "__doc__", None)
    return comment(doc) if doc else []


def snake(name: str) -> str:
    """Return a class's name as C writes it."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def wrapped_lines(line: str) -> list[str]:
    """Return a line of C in lines of at most COLUMNS, where it can be broken."""
    if len(line) <= COLUMNS:
        return [line]
    if line.lstrip().startswith(("/*", "*")):
        return _wrapped_comment(line)
    code, mark, words = line.partition(" /* ")
    if mark and len(code) <= COLUMNS:
        pad = code[: len(code) - len(code.lstrip())]
        return [*_wrapped_comment(f"{pad}/* {words}"), code]
    pad = code[: len(code) - len(code.lstrip())] + "        "
    found, rest = [], code
    while len(rest) > COLUMNS:
        at = _break(rest, len(pad))
        if at < 0:
            break
        found.append(rest[:at].rstrip())
        rest = pad + rest[at:].lstrip()
    found.append(rest)
    if mark:
        lead = line[: len(line) - len(line.lstrip())]
        found[:0] = _wrapped_comment(f"{lead}/* {words}")
    return found


def _wrapped_comment(line: str) -> list[str]:
    pad = line[: len(line) - len(line.lstrip())]
    return textwrap.wrap(line, COLUMNS, subsequent_indent=f"{pad} * ", break_long_words=False)


def _break(line: str, least: int) -> int:
    """Return where to break: before an operator or behind a comma, the outermost one."""
    best, rank, depth = -1, 99, 0
    for i, letter in enumerate(line[:COLUMNS]):
        depth += letter in "([{"
        depth -= letter in ")]}"
        if i <= least + 8 or letter != " ":
            continue
        comma = line[i - 1] == ","
        operator = re.match(r" (\+|-|\*|/|&&|\|\||\?|:|=) ", line[i:])
        if (comma or operator) and depth <= rank:
            at = i if comma or (operator and operator[1] != "=") else i + 2
            best, rank = at, depth
    return best


def _initialiser(array: Any) -> str:
    if array.ndim > 1:
        return "{" + ", ".join(_initialiser(row) for row in array) + "}"
    if array.dtype.kind == "b":
        return "{" + ", ".join("true" if value else "false" for value in array) + "}"
    if array.dtype.kind in "iu":
        return "{" + ", ".join(str(int(value)) for value in array) + "}"
    return "{" + ", ".join(number_text(float(value)) for value in array) + "}"


__all__ = ["ROLES", "Unit", "module_comment", "snake", "wrapped_lines"]
