"""What a value of a step is in C: a number, a structure of ports, an array, or a function.

Of Python's numbers float is double, int is int32_t, bool is bool. A View is a pointer to a struct
with the ports' names, Cells are an array of a fixed shape. A Callee is a function given to another
one: it is called directly, not passed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pcpc.drivers.compiled.views import Field, Layout
from pcpc.drivers.errors import UserError

_RESERVED = {
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else",
    "enum", "extern", "float", "for", "goto", "if", "inline", "int", "long", "register",
    "restrict", "return", "short", "signed", "sizeof", "static", "struct", "switch", "typedef",
    "union", "unsigned", "void", "volatile", "while", "bool", "true", "false", "asm", "typeof",
    "main",
}  # fmt: skip


class Untranslatable(UserError):
    """What has no meaning in C: `file:line: what; what to write instead`."""


@dataclass(frozen=True)
class Number:
    """A number, by its type in C."""

    name: str


FLOAT, WHOLE, TRUTH = Number("double"), Number("int32_t"), Number("bool")
_ORDER = (TRUTH, WHOLE, FLOAT)


@dataclass(frozen=True)
class View:
    """A declaration's ports."""

    layout: Layout


@dataclass(frozen=True)
class CellsKind:
    """An array of a fixed shape, row by row."""

    shape: tuple[int, ...]
    element: Number = FLOAT


@dataclass(frozen=True)
class Callee:
    """A function that is handed to another one."""

    function: Callable[..., Any]


@dataclass(frozen=True)
class Several:
    """The results of a function that returns more than one."""

    kinds: tuple[Number, ...]


Kind = Number | View | CellsKind | Callee | Several | None


@dataclass(frozen=True)
class Value:
    """An expression in C.

    `level`: how tight its outermost operator binds, 16 for a name. `root`: the variable into whose
    memory it points. `pointer`: of a View, whether `->` takes its parts. `fixed`: no statement can
    change what it is.
    """

    text: str
    kind: Kind
    level: int = 16
    root: str = ""
    pointer: bool = True
    fixed: bool = False

    def at(self, level: int) -> str:
        """Return the text for a place that asks for this level."""
        return self.text if self.level >= level else f"({self.text})"

    def address(self) -> str:
        """Return the text of a pointer to it."""
        return self.text if self.pointer else f"&{self.text}"


def common_kind(a: Kind, b: Kind) -> Kind:
    """Return the kind that holds both; None if there is none."""
    if a == b or b is None:
        return a
    if a is None:
        return b
    if a in (WHOLE, FLOAT) and b in (WHOLE, FLOAT):
        return max(a, b, key=lambda kind: _ORDER.index(kind))
    return None


def size(layout: Layout) -> int:
    """Return the number of doubles of a layout."""
    return sum(field_size(field) for field in layout.fields)


def field_size(field: Field) -> int:
    """Return the number of doubles of a field."""
    if field.group is not None:
        return size(field.group)
    count = 1
    for extent in field.shape:
        count *= extent
    return count


def c_name(name: str) -> str:
    """Return a name that C does not keep for itself."""
    return f"{name}_" if name in _RESERVED else name


def number_text(value: float) -> str:
    """Return the literal of a double."""
    if value != value:
        return "PCPC_NAN"
    if value in (float("inf"), float("-inf")):
        return "PCPC_INFINITY" if value > 0 else "-PCPC_INFINITY"
    return repr(float(value))
