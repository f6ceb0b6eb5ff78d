"""Keyframes of a node: how often, what is in one, what cannot be, how a node goes on from it.

    keyframe_seq    a seqlock, as that of the snapshot
    keyframe        [passes, cycle, stamp ns], then the bytes of `KEPT` in its order

In there is all that a node carries from one cycle to the next. Not: what is set once at the start,
what only clocks measure, and what a recomputed node does not have, as addresses of senders and the
meeting. `nodes.install` and the log give these. `executive.loop.keyframes` copies.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from pcpc.executive.log.description import NodeDescription
from pcpc.executive.log.keyframes import Keyframe
from pcpc.executive.loop.layout import LOOP, Loop
from pcpc.executive.loop.variables import REFUSALS
from pcpc.executive.nodes import planned_drive
from pcpc.executive.nodes.acting_faults import Seam
from pcpc.executive.nodes.part import Part, Plan

Span = tuple[str, str, int, int]  # record, field, offset in LOOP, bytes; ("", "v") first

KEPT: Mapping[str, Mapping[str, tuple[str, ...]]] = {  # record -> field -> its columns, () for all
    name: kind.carried_fields for name, kind in Loop.records().items() if kind.carried_fields
}
_OF_DRIVES = "canopen", "robot"  # records of which a node has one or none
_LARGEST = 1 << 62  # cycles, ns, counts
_BITS = ("odd_bits",)  # words that hold a float64: of a value that is not finite, for one
_MEASURED = ("late", "skipped", "sent", "send_errors", "bus_errno", "wake_max_ns",
             "refused")  # fmt: skip  # control words; no log holds what was refused
_REFUSALS = {name for name, *_ in REFUSALS}
_ANY_NUMBER = ("input", "output", "received", "sent")  # kinds of variables
_LARGEST_VALUE = 2.0**53  # a law that counts more ticks would look beside its rings


class Keyframes(Part):
    """The states of the whole node that a log keeps."""

    def install(self, made: Plan, loop: Loop) -> None:
        """Write which bytes to copy, and when."""
        let_keep(loop, held_spans(made), passes_of(made))

    def described(self, made: Plan) -> NodeDescription:
        """Return how often, how large, and what lies where in one."""
        held = held_spans(made)
        return {
            "keyframe_passes": passes_of(made),
            "keyframe_bytes": size_of(held),
            "keyframe_layout": name_of(held, made.names),
        }


def passes_of(made: Plan) -> int:
    """Return the passes between two keyframes, 0 for none: not all state is the table's then."""
    config = made.rig.config
    elsewhere = made.external or any(one.is_opaque for one in made.spec.blocks)
    if elsewhere or not config.record.keyframe_ns:
        return 0
    return max(1, round(1e-9 * config.record.keyframe_ns * config.rate_hz))


# What is in one


def held_spans(made: Plan) -> Sequence[Span]:
    """Return what a keyframe of the node holds."""
    drive = planned_drive.drive_of(made.rig, made.role)
    profile = None if drive is None else drive.profile
    return spans(len(made.table.variables), bool(made.faults), profile)


@cache
def spans(variables: int, faults: bool, profile: str | None = None) -> Sequence[Span]:
    """Return what a keyframe holds of a node with so many variables.

    `faults`: there are some on purpose; `profile`: of its drive.
    """
    kinds: Any = LOOP.fields
    held = [("", "v", int(kinds["v"][1]), 8 * variables)]
    own = None if profile is None else "canopen" if profile == planned_drive.CIA402 else "robot"
    for record, names in KEPT.items():
        if record in _OF_DRIVES and record != own:
            continue
        kind, offset = kinds[record][:2]
        for name in names:
            inner, place = kind.fields[name][:2]
            if faults or name not in Loop.records()[record].large_fields:
                held.append((record, name, offset + place, inner.itemsize))
    return held


def size_of(held: Sequence[Span]) -> int:
    """Return the bytes of the state in a keyframe."""
    return sum(size for *_, size in held)


def name_of(held: Sequence[Span], variables: Sequence[str]) -> str:
    """Return a name for what lies where in a keyframe: 16 hexadecimal digits.

    Where it lies in LOOP is none of it: a log of before another record grew has the same name.
    """
    kinds = [(record, name, _kind_of(record, name), size) for record, name, _, size in held]
    return hashlib.sha256(repr((kinds, list(variables))).encode()).hexdigest()[:16]


@cache
def _kind_of(record: str, name: str) -> str:
    """Return a field's type in words, which numpy takes long for."""
    return str(_type_of(record, name))


def _type_of(record: str, name: str) -> np.dtype[Any]:
    """Return a field's type with its shape; record "" for one of LOOP itself."""
    of_record: Any = LOOP[record].fields if record else LOOP.fields
    kind: np.dtype[Any] = of_record[name][0]
    return kind


def fields(held: Sequence[Span], state: bytes) -> Iterator[tuple[str, str, Any]]:
    """Yield record, field and values, flat, of what a keyframe holds."""
    offset = 0
    for record, name, _, size in held:
        kind = _type_of(record, name).base
        yield record, name, np.frombuffer(state, kind, size // kind.itemsize, offset)
        offset += size


# Into a node and out of it


def let_keep(loop: Loop, held: Sequence[Span], every: int) -> None:
    """Let the loop keep a keyframe every so many passes; 0 for none."""
    keep, spans, past, base = loop.keep, list[tuple[int, int]](), -1, held[0][2]
    for _, _, offset, size in held:
        if offset == past:
            begin, length = spans[-1]
            spans[-1] = begin, length + size
        else:
            spans.append((offset - base, size))
        past = offset + size
    n = len(spans)
    keep.span[:n] = spans
    keep.n, keep.every, keep.next = n, every, every - 1 if every else -1


def restore(made: Plan, loop: Loop, frame: Keyframe) -> None:
    """Let a node, as it was installed, stand behind the cycle of a keyframe."""
    put_back(loop, held_spans(made), frame.state)
    loop.k, loop.passes = frame.cycle + 1, frame.passes + 1
    loop.keep.next = frame.passes + loop.keep.every if loop.keep.every else -1


def put_back(loop: Loop, held: Sequence[Span], state: bytes) -> None:
    """Put the state of a keyframe into a node, as it was installed."""
    for record, name, values in fields(held, state):
        if not record:
            loop.v[: len(values)] = values
            continue
        into, columns = loop[record], KEPT[record][name]
        shape = np.shape(into[name])
        for column in columns:
            into[name][column] = values.reshape(shape)[column]
        if not columns:
            into[name] = values.reshape(shape) if shape else values[0]


# What cannot be, and what differs


def why_none(made: Plan, state: bytes) -> str:
    """Return why nothing goes on from the state of a keyframe, in words; "" if a node can.

    What laws and frames give may be any number, or none; what they and the loop count with may not.
    """
    if what := impossible(held_spans(made), state):
        return f"{what}, which no run has"
    values = np.frombuffer(state, "<f8", len(made.table.variables))
    spoiled = {one.target for one in made.faults if one.group == Seam.VALUES}
    for i, (variable, value) in enumerate(zip(made.table.variables, values, strict=True)):
        low, high = -_LARGEST_VALUE, _LARGEST_VALUE
        if variable.kind == "parameter":
            low, high = max(low, variable.low), min(high, variable.high)
        can_be = low <= value <= high or i in spoiled
        can_be |= variable.kind in _ANY_NUMBER and variable.writer != "drive"
        if not (can_be or variable.timing or value == made.values.get(i)):
            why = "a law need not survive" if variable.kind == "state" else "no run has"
            return f"{variable.name} is {value:g}, which {why}"
    return ""


def impossible(held: Sequence[Span], state: bytes) -> str:
    """Return which count of a keyframe no run has, in words; "" for none."""
    for record, name, values in fields(held, state):
        for column in (values[one] for one in values.dtype.names or (...,) if name not in _BITS):
            wrong = column[(column < -_LARGEST) | (column > _LARGEST)]
            if column.dtype.kind == "i" and len(wrong):
                return f"{record}.{name} is {wrong[0]}"
    return ""


def differences(made: Plan, one: bytes, other: bytes) -> Iterator[tuple[str, Any, Any]]:
    """Yield name and both values where two states of a node differ, what was measured aside."""
    held, variables, past = held_spans(made), made.table.variables, 0
    for record, name, _, size in held:
        here, past = slice(past, past + size), past + size
        if one[here] == other[here] or (record == "control" and name in _MEASURED):
            continue
        kind = _type_of(record, name).base
        old, new = (np.frombuffer(state[here], kind) for state in (one, other))
        for i in (i for i in range(len(old)) if old[i].tobytes() != new[i].tobytes()):
            if record:
                yield f"{record}.{name}[{i}]", old[i].item(), new[i].item()
            elif not variables[i].timing and variables[i].name not in _REFUSALS:
                yield variables[i].name, float(old[i]), float(new[i])
