"""What a log says about itself, checked once, where it is read: wrong parts are left out and told.

    description    `<node>.json`: each key is of its type, or it is not there
    facts          metadata of a node: clocks and period are numbers that time can have
    entry          an event or a tuning: an object whose parts are of their types
    frames         at most 8 bytes, sent or received, at a time and in a cycle that can be

Texts are printable. So that whoever reads a log needs no checks of his own.
"""

import json
import re
from collections.abc import Mapping
from typing import Annotated, Any, get_type_hints

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from pcpc.drivers.can.wire_layout import LENGTHS, Flag
from pcpc.drivers.errors import printable
from pcpc.executive.log.description import (
    LATEST,
    LONGEST_PERIOD_NS,
    CheckedDescription,
    NodeDescription,
    Number,
    node_description,
)

_Int = Annotated[int, Meta(ge=-LATEST, le=LATEST)]
_Word = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]  # what somebody asked for, whatever it was
_KINDS: dict[str, Any] = get_type_hints(CheckedDescription, include_extras=True) | {
    "files": list[dict[str, str | bool | int | list[str]]],  # earlier versions had fewer keys
    "variables": list[tuple[str, str, str, str, str]],
    "ranges": dict[str, tuple[Number, Number]],
}
_ENTRY: dict[str, Any] = {
    "cycle": _Int, "stamp_ns": _Int, "name": str, "event": str, "argument": _Word,
    "value": Number | str,
}  # fmt: skip
PARTS = tuple(_ENTRY)
_NEEDED = ("cycle", "stamp_ns", "value")
_NUMBER_TEXT = re.compile(r"-?(nan|inf)")
_WHOLE = re.compile(r"-?[0-9]{1,19}")


def parse_json(text: str | bytes) -> Any:
    """Return a JSON value with printable texts; ValueError whatever is wrong with it."""
    try:
        return _clean(json.loads(text))
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _clean(value: Any) -> Any:
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, list):
        return [_clean(part) for part in value]
    if isinstance(value, dict):
        return {printable(key): _clean(part) for key, part in value.items()}
    return value


def _fits(value: Any, kind: Any) -> bool:
    try:
        msgspec.convert(value, kind)
    except (msgspec.ValidationError, OverflowError):
        return False
    return True


def description(value: Mapping[str, Any]) -> tuple[NodeDescription, list[str]]:
    """Return the keys of a node's description that are of their type, and the names of others."""
    wrong = [key for key, kind in _KINDS.items() if key in value and not _fits(value[key], kind)]
    right = {key: part for key, part in value.items() if key not in wrong}
    return node_description(right), wrong


def facts(metadata: Mapping[str, str]) -> tuple[dict[str, str], list[str]]:
    """Return a node's metadata without numbers that cannot be (clocks: 0), and their names."""
    low = {"clock_wall_ns": 0, "clock_monotonic_ns": 0, "period_ns": 1}
    high = {"period_ns": LONGEST_PERIOD_NS}
    wrong = [
        key
        for key in low
        if key in metadata
        and not (
            _WHOLE.fullmatch(metadata[key])
            and low[key] <= int(metadata[key]) <= high.get(key, LATEST // 2)
        )
    ]
    clocks = {key: "0" for key in wrong if key != "period_ns"}
    return {key: text for key, text in metadata.items() if key not in wrong} | clocks, wrong


def counts(metadata: Mapping[str, str]) -> dict[str, str]:
    """Return what a recorder counted, without what is no count."""
    return {key: text for key, text in metadata.items() if re.fullmatch("[0-9]{1,18}", text)}


def entry(text: bytes, named: bool = False) -> dict[str, Any] | None:
    """Return an event or tuning, which must be `named`; None if it is none."""
    try:
        parsed = parse_json(text)
    except ValueError:
        return None
    needed = (*_NEEDED, "name") if named else _NEEDED
    if not isinstance(parsed, dict) or not all(key in parsed for key in needed):
        return None
    if not all(_fits(parsed[key], kind) for key, kind in _ENTRY.items() if key in parsed):
        return None
    value = parsed["value"]
    if isinstance(value, str) and not _NUMBER_TEXT.fullmatch(value):
        return None
    return {key: part for key, part in parsed.items() if not isinstance(part, list | dict)}


def possible_frames(frames: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which frames (n,) of `logs.FRAME` a bus could have carried, (n,)."""
    length, fd = frames["dlc"], frames["flags"] & Flag.FD != 0
    fd &= frames["data"].shape[1] > 8
    possible = np.where(fd, np.isin(length, LENGTHS), length <= 8) & (frames["direction"] <= 1)
    for name in ("stamp_ns", "cycle"):
        possible &= (frames[name] >= -LATEST // 2) & (frames[name] <= LATEST // 2)
    return np.asarray(possible)


def unwrapped_cycles(sequence: NDArray[np.int64], before: int | None = None) -> NDArray[np.int64]:
    """Return cycle numbers of their low 32 bits; a fall by more than half of these is a wrap.

    `before` is the cycle ahead of the first. Both (n,).
    """
    if not len(sequence):
        return sequence
    first = int(sequence[0]) if before is None else before
    low = np.concatenate(([first & 0xFFFFFFFF], sequence))
    return sequence + (first >> 32 << 32) + (np.cumsum(np.diff(low) < -(1 << 31)) << 32)
