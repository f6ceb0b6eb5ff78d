"""What is in a keyframe: all that a node carries from one cycle to the next (no numba here).

    keyframe_seq    a seqlock, as that of the snapshot
    keyframe        [passes, cycle, stamp ns], then the bytes of `KEPT` in its order

Not in there: what is set once at the start, what only clocks measure, and what a recomputed node
does not have, as addresses of senders and the meeting. `nodes.install` and the log give these.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from pcpc.executive.loop.layout import LOOP, Loop

Span = tuple[str, str, int, int]

HEAD_WORDS = 3  # passes, cycle, stamp ns
Marks = Mapping[str, Mapping[str, tuple[str, ...]]]  # record -> field -> its columns, () for all


def _marks_of(*names: str) -> Marks:
    kinds = Loop.records()
    return {name: kinds[name].carried_fields for name in names or kinds}


OF_DRIVE, OF_ROBOT = _marks_of("canopen"), _marks_of("robot")
_OF_DRIVES = {**OF_ROBOT, **OF_DRIVE}
KEPT = {name: marks for name, marks in _marks_of().items() if marks and name not in _OF_DRIVES}
NO_DRIVE: Marks = {}
_LARGEST = 1 << 62  # cycles, ns, counts
_BITS = ("odd_bits",)  # words that hold a float64: of a value that is not finite, for one


def spans(variables: int, faults: bool, more: Marks = NO_DRIVE) -> list[Span]:
    """Return what a keyframe holds of a node with so many variables.

    `faults`: there are some on purpose; `more`: OF_DRIVE or OF_ROBOT of such a node. Record, field,
    offset in LOOP and bytes; ("", "v") first.
    """
    kinds: Any = LOOP.fields
    content = [("", "v", int(kinds["v"][1]), 8 * variables)]
    for record, names in {**KEPT, **more}.items():
        kind, offset = kinds[record][:2]
        for name in names:
            inner, place = kind.fields[name][:2]
            if faults or name not in Loop.records()[record].large_fields:
                content.append((record, name, offset + place, inner.itemsize))
    return content


def size_of(held: Sequence[Span]) -> int:
    """Return the bytes of the state in a keyframe."""
    return sum(size for *_, size in held)


def name_of(content: Sequence[Span], variables: Sequence[str]) -> str:
    """Return a name for what lies where in a keyframe: 16 hexadecimal digits."""
    kinds = [_kind_of(record or name) for record, name, _, _ in content]
    return hashlib.sha256(repr((content, kinds, list(variables))).encode()).hexdigest()[:16]


@cache
def _kind_of(record: str) -> str:
    """Return a record's type in words, which numpy takes milliseconds for."""
    return str(LOOP[record])


def install(loop: Loop, content: Sequence[Span], every: int) -> None:
    """Let the loop keep a keyframe every so many passes; 0 for none."""
    keep, n, past, base = loop.keep, 0, -1, content[0][2]
    for _, _, offset, size in content:
        if offset == past:
            keep.span[n - 1].length += size
        else:
            keep.span[n] = (offset - base, size)
            n += 1
        past = offset + size
    keep.n, keep.every, keep.next = n, every, every - 1 if every else -1


def impossible(held: Sequence[Span], state: bytes) -> str:
    """Return which value of a keyframe no run has, in words; "" for none."""
    for record, name, values in fields(held, state):
        for column in (values[one] for one in values.dtype.names or (...,) if name not in _BITS):
            wrong = column[(column < -_LARGEST) | (column > _LARGEST)]
            if column.dtype.kind == "i" and len(wrong):
                return f"{record}.{name} is {wrong[0]}"
    return ""


def restore(loop: Loop, held: Sequence[Span], state: bytes) -> None:
    """Put a keyframe into a node, as it was installed."""
    for record, name, values in fields(held, state):
        if not record:
            loop.v[: len(values)] = values
            continue
        into, columns = loop[record], {**KEPT, **_OF_DRIVES}[record][name]
        shape = np.shape(into[name])
        for column in columns:
            into[name][column] = values.reshape(shape)[column]
        if not columns:
            into[name] = values.reshape(shape) if shape else values[0]


def fields(content: Sequence[Span], state: bytes) -> Iterator[tuple[str, str, Any]]:
    """Yield record, field and values, flat, of what a keyframe holds."""
    offset = 0
    for record, name, _, size in content:
        of_record: Any = LOOP[record].fields if record else LOOP.fields
        kind = of_record[name][0].base
        yield record, name, np.frombuffer(state, kind, size // kind.itemsize, offset)
        offset += size
