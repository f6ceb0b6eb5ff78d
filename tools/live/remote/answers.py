"""What a host may answer: checked before anything of it is used, as it may be anybody.

Text loses what a terminal would obey. What a node says about itself has the form that
`executive.nodes.plan.describe` gives it, and what it publishes fits that.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.loop.faults import FAULT_NAMES
from pcpc.executive.loop.states import STATE_NAMES
from pcpc.executive.rig.roles import Role
from pcpc.tools.terminal import screen

Word = Annotated[str, Meta(max_length=1000)]
Nanoseconds = Annotated[str, Meta(pattern=r"^-?[0-9]{1,19}$")]
_MOST_S = 1e9  # of a run


class _Fault(Struct):
    kind: Word
    of: Word | None
    next_cycle: bool


class _Metadata(Struct):
    pacing: Word
    bus: Word
    controller: Word
    rate_hz: Word
    clock_wall_ns: Nanoseconds
    clock_monotonic_ns: Nanoseconds


class _Node(Struct):
    name: Word
    rig: Word
    node: Role
    period_ns: Annotated[int, Meta(ge=1, le=10**12)]
    cycles: Annotated[int, Meta(ge=0, le=2**62)]
    watch: Word | None
    alarms: dict[Word, float | None]
    variables: Annotated[
        list[tuple[Word, Word, Word, Word, str]], Meta(min_length=1, max_length=sh.MAX_VARIABLES)
    ]
    ranges: dict[Word, tuple[float, float]]
    state_columns: list[Word]
    timing_columns: list[Word]
    record_columns: Annotated[int, Meta(ge=1, le=sh.RECORD_RING_WORDS)]
    sources: dict[Word, Word]
    blocks: list[Word]
    laws: list[Word]
    faults: dict[Word, _Fault]
    frames: dict[Word, Word]
    state_names: Annotated[list[Word], Meta(min_length=len(STATE_NAMES))]
    fault_names: Annotated[list[Word], Meta(min_length=len(FAULT_NAMES))]
    attachments: dict[str, str]
    files: list[dict[str, Any]]
    metadata: _Metadata
    keep_ns: int
    keep_on: list[Word]
    initial: dict[Word, float] = {}
    file: str = ""


def description_in(told: Any) -> dict[str, Any]:
    """Return what a node says about itself; ValueError, TypeError, KeyError if it is nothing."""
    about = told["about"]
    node = msgspec.convert(about, _Node)
    sharing.check(about)
    names = {name for name, *_ in node.variables}
    if len(names) < len(node.variables):
        raise ValueError("two variables of one name")
    msgspec.convert(about["metadata"], dict[str, str])
    named = {*node.ranges, *node.initial, *node.state_columns, *node.timing_columns}
    if not named | {"time.t_s", "supervisor.state"} <= names:
        raise ValueError("an unknown variable")
    if any(not key.isdecimal() for key in node.frames):
        raise ValueError("a frame without an id")
    return dict(about)


def check_values(found: Mapping[str, NDArray[Any]], about: Mapping[str, Any]) -> None:
    """Raise ValueError where published values are none that a node of this kind has.

    `snapshot`: (variables,).
    """
    control: Any = found["control"]
    for word, names in (("state", "state_names"), ("fault", "fault_names")):
        if not 0 <= int(control[word]) < len(about[names]):
            raise ValueError("an unknown state")
    if min(int(control.cycle), int(control.passes)) < -1 or int(control.cycle) > 2**62:
        raise ValueError("an impossible cycle")
    if "snapshot" in found:
        kinds = [(row[0], row[2]) for row in about["variables"]]
        for (name, kind), value in zip(kinds, found["snapshot"].tolist(), strict=True):
            own = kind == "supervisor" or name.startswith(("time.", "handover."))
            if own and not (math.isfinite(value) and abs(value) < _MOST_S):
                raise ValueError(f"{name} is not a number")


def rows_of_width(rows: NDArray[np.int64], columns: int) -> NDArray[np.int64]:
    """Return rows that have so many columns; ValueError. Shape (n, columns)."""
    if len(rows) and rows.shape[1] != columns:
        raise ValueError("rows of another size")
    return rows


def clean(told: Any) -> Any:
    """Return an answer whose texts hold nothing that a terminal would obey."""
    if isinstance(told, str):
        return screen.clean(told)
    if isinstance(told, list):
        return [clean(one) for one in told]
    if isinstance(told, dict):
        return {screen.clean(key): clean(one) for key, one in told.items()}
    return told
