"""Records: what numpy gets of a declaration, and what is carried."""

import mmap
from typing import Any

import numpy as np
import pytest

from pcpc.drivers.compiled.records import (
    Byte,
    Bytes,
    Cells,
    Element,
    Record,
    carried,
    cells,
    line,
)


class Three(Bytes):
    """Three bytes."""

    count = 3


class Pair(Element):
    """Without gaps, by name."""

    whole: int
    real: float


class Lines(Element):
    """On two lines of the cache, the second one full."""

    a: int = line()
    b: int = carried(line=True)
    c: int


class Base(Record):
    """Each kind of field."""

    byte: Byte
    number: int = carried()
    few: Three
    bytes: Cells[Byte] = carried(shape=5, large=True)
    frames: Cells[Three] = cells(4, 2)


class Derived(Base):
    """The fields of another one, then records."""

    pair: Pair
    pairs: Cells[Pair] = carried("real", shape=(2, 3))
    last: float = carried()


class Filled(Record, fills="rest"):
    """A part of a page."""

    n: int


class Whole(Record, fills="rest"):
    """A whole page, which gets another one."""

    n: Cells[int] = cells(mmap.PAGESIZE // 8)


PAIR = np.dtype((np.record, [("whole", "<i8"), ("real", "<f8")]))
BASE: list[Any] = [
    ("byte", "u1"), ("number", "<i8"), ("few", "u1", (3,)), ("bytes", "u1", (5,)),
    ("frames", "u1", (4, 2, 3)),
]  # fmt: skip
MORE = [("pair", PAIR), ("pairs", PAIR, (2, 3)), ("last", "<f8")]
REST = ("rest", "u1", (mmap.PAGESIZE - 8,))


@pytest.mark.parametrize(
    ("kind", "wanted"),
    [
        (Pair, PAIR),
        (Base, np.dtype(BASE, align=True)),
        (Derived, np.dtype([*BASE, *MORE], align=True)),
        (Filled, np.dtype([("n", "<i8"), REST], align=True)),
        (
            Whole,
            np.dtype(
                [("n", "<i8", (mmap.PAGESIZE // 8,)), ("rest", "u1", (mmap.PAGESIZE,))], align=True
            ),
        ),
    ],
)
def test_a_declaration_is_the_type_that_numpy_makes_of_its_fields(
    kind: type[Record], wanted: np.dtype[Any]
) -> None:
    assert kind.dtype == wanted and repr(kind.dtype) == repr(wanted)
    assert kind.dtype.type is wanted.type and kind.dtype.alignment == wanted.alignment


def test_a_line_begins_where_it_is_said() -> None:
    places = [Lines.offset_of(name) for name in ("a", "b", "c")]
    assert places == [0, 64, 72] and Lines.dtype.itemsize == 128
    assert np.zeros(1, Lines.dtype)[0].c == 0


def test_what_is_carried_is_marked_with_its_columns_and_the_large_comes_last() -> None:
    assert list(Derived.carried_fields.items()) == [
        ("number", ()), ("pairs", ("real",)), ("last", ()), ("bytes", ()),
    ]  # fmt: skip
    assert Derived.large_fields == ("bytes",) and Lines.carried_fields == {"b": ()}
    assert Pair.carried_fields == {}


def test_the_records_among_the_fields_are_known_by_name() -> None:
    assert Derived.records() == {"pair": Pair} and Base.records() == {}
