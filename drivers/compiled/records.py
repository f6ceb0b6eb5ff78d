"""Records: the memory of compiled code, declared once, as numpy has it and as mypy knows it.

    class Safe(Element):                    an element of an array
        last: float
        safe: float

    class Guard(Record):
        n_safe: int                     int64, float64, Byte; a further record
        place: Cells[int] = cells(MAX_LIMITS)
        safe: Cells[Safe] = carried("last", shape=MAX_LIMITS)
        gain: float = carried()

    @loop_function
    def supervise(n: Loop) -> None:     n.guard.gian is an error of mypy, and of the editor

The order of declaration is the order in memory, `dtype`; a derived class begins with the fields of
its bases. What a node carries from one cycle to the next is marked where it is declared, of rows
perhaps only some columns: `carried_fields`, which keyframes hold.

There are no instances: interpreted, an argument of such a type is a record of numpy, compiled it is
a pointer (`drivers.compiled.structures`).
"""

import inspect
import mmap
from collections.abc import Callable, Iterator, Mapping
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Generic,
    NamedTuple,
    SupportsIndex,
    TypeVar,
    get_args,
    get_origin,
    overload,
)

import numpy as np

LINE_BYTES = 64  # of a cache line

Byte = Annotated[int, "u1"]
_NUMBERS: Mapping[Any, str] = {int: "<i8", float: "<f8", Byte: "u1"}
_T = TypeVar("_T")
_Shape = int | tuple[int, ...]

_int64: Any = np.int64
int64: Callable[[Any], int] = _int64  # a number of compiled code; mypy takes it for an int


class Cells(Generic[_T]):
    """What a field with a shape has: numbers, frames or records."""

    if TYPE_CHECKING:
        shape: tuple[int, ...]

        @overload
        def __getitem__(self, place: SupportsIndex) -> _T: ...
        @overload
        def __getitem__(self, place: Any) -> Any: ...
        def __getitem__(self, place: Any) -> Any: ...
        def __setitem__(self, place: Any, value: Any) -> None: ...
        def __len__(self) -> int: ...
        def __iter__(self) -> Iterator[_T]: ...


class Bytes(Cells[Byte]):
    """A number of bytes that is the same wherever it is declared, `count`."""

    count: ClassVar[int]


class Field(NamedTuple):
    """How a field is declared beside its type."""

    shape: tuple[int, ...] = ()
    line: bool = False  # begins a line of the cache
    carried: bool = False
    columns: tuple[str, ...] = ()  # that are; () for all
    large: bool = False  # left out where nobody uses it


def cells(*shape: int) -> Any:
    """Declare a field with a shape."""
    return Field(shape)


def line() -> Any:
    """Declare a field that begins a line of the cache: it has another writer than those before."""
    return Field(line=True)


def carried(*columns: str, shape: _Shape = (), line: bool = False, large: bool = False) -> Any:
    """Declare a field that is carried from one cycle to the next; of its rows these columns."""
    shape = shape if isinstance(shape, tuple) else (shape,)
    return Field(shape, line, True, columns, large)


def _dtype(cls: "type[Record]") -> np.dtype[Any]:
    fields = [(name, *_format(kind, mark.shape)) for name, (kind, mark) in cls._fields.items()]
    lines = [name for name, (_, mark) in cls._fields.items() if mark.line]
    if lines:
        return _on_lines(fields, lines)
    if cls._by_name:
        return np.dtype((np.record, fields))
    return np.dtype(fields, align=True)


def _format(kind: Any, shape: tuple[int, ...]) -> tuple[Any, ...]:
    """Return numpy's type of a field, and its shape if it has one."""
    if isinstance(kind, type) and issubclass(kind, Bytes):
        return "u1", (*shape, kind.count)
    if get_origin(kind) is Cells:
        return _format(get_args(kind)[0], shape)
    found = _NUMBERS.get(kind) or kind.dtype
    return (found, shape) if shape else (found,)


def _on_lines(fields: list[tuple[Any, ...]], lines: list[str]) -> np.dtype[Any]:
    """Return the type of numbers of 8 bytes, some of which begin lines."""
    places: dict[str, int] = {}
    end = 0
    for name, _ in fields:
        if name in lines:
            end += -end % LINE_BYTES
        places[name], end = end, end + 8
    return np.dtype((np.record, {
        "names": list(places), "formats": [kind for _, kind in fields],
        "offsets": list(places.values()), "itemsize": end + -end % LINE_BYTES, "aligned": True,
    }))  # fmt: skip


class Record:
    """Base of declarations."""

    dtype: ClassVar[np.dtype[Any]]
    carried_fields: ClassVar[Mapping[str, tuple[str, ...]]]  # their columns; the large ones last
    large_fields: ClassVar[tuple[str, ...]]
    _fields: ClassVar[Mapping[str, tuple[Any, Field]]] = {}
    _by_name: ClassVar[bool] = False

    def __init_subclass__(cls, fills: str = "") -> None:
        """Lay out the fields; one that is named `fills` fills the last page of memory."""
        fields: dict[str, tuple[Any, Field]] = {}
        for base in cls.__bases__:
            fields |= getattr(base, "_fields", {})
        for name, kind in inspect.get_annotations(cls).items():
            fields[name] = kind, vars(cls).get(name, Field())
        cls._fields = fields
        cls.dtype = _dtype(cls)
        if fills:
            rest = -cls.dtype.itemsize % mmap.PAGESIZE or mmap.PAGESIZE
            cls._fields = fields | {fills: (Cells[Byte], Field((rest,)))}
            cls.dtype = _dtype(cls)
        marks = {name: mark for name, (_, mark) in cls._fields.items() if mark.carried}
        ordered = sorted(marks, key=lambda name: marks[name].large)
        cls.carried_fields = {name: marks[name].columns for name in ordered}
        cls.large_fields = tuple(name for name in ordered if marks[name].large)

    @classmethod
    def offset_of(cls, name: str) -> int:
        """Return where a field lies, in bytes."""
        places: Any = cls.dtype.fields
        return int(places[name][1])

    @classmethod
    def records(cls) -> "dict[str, type[Record]]":
        """Return the fields that are records."""
        kinds = {name: kind for name, (kind, _) in cls._fields.items() if isinstance(kind, type)}
        return {name: kind for name, kind in kinds.items() if issubclass(kind, Record)}

    if TYPE_CHECKING:

        def __getitem__(self, name: str) -> Any: ...
        def __setitem__(self, name: str, value: Any) -> None: ...


class Element(Record):
    """One whose values numpy gives by name, too, as an element of an array; without gaps."""

    _by_name = True
