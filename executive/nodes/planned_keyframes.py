"""What a plan says of the keyframes of its node: how often, what is in them, what cannot be."""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from pcpc.executive.log.description import NodeDescription
from pcpc.executive.log.keyframes import Keyframe
from pcpc.executive.loop import keyframe_layout as layout
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.variables import REFUSALS
from pcpc.executive.nodes import planned_drive
from pcpc.executive.nodes.acting_faults import Seam
from pcpc.executive.nodes.part import Part, Plan

_MEASURED = ("late", "skipped", "sent", "send_errors", "bus_errno", "wake_max_ns",
             "refused")  # fmt: skip  # control words; no log holds what was refused
_REFUSALS = {name for name, *_ in REFUSALS}
_ANY_NUMBER = ("input", "output", "received", "sent")  # kinds of variables
_LARGEST = 2.0**53  # a law that counts more ticks would look beside its rings


class Keyframes(Part):
    """The states of the whole node that a log keeps."""

    def install(self, made: Plan, loop: Loop) -> None:
        """Write which bytes to copy, and when."""
        layout.install(loop, held_spans(made), passes_of(made))

    def described(self, made: Plan) -> NodeDescription:
        """Return how often, how large, and what lies where in one."""
        spans = held_spans(made)
        return {
            "keyframe_passes": passes_of(made),
            "keyframe_bytes": layout.size_of(spans),
            "keyframe_layout": layout.name_of(spans, made.names),
        }


def passes_of(made: Plan) -> int:
    """Return the passes between two keyframes, 0 for none: not all state is the table's then."""
    config = made.rig.config
    elsewhere = made.external or any(one.is_opaque for one in made.spec.blocks)
    if elsewhere or not config.record.keyframe_ns:
        return 0
    return max(1, round(1e-9 * config.record.keyframe_ns * config.rate_hz))


def held_spans(made: Plan) -> list[layout.Span]:
    """Return what a keyframe of the node holds."""
    drive = planned_drive.drive_of(made.rig, made.role)
    profile = None if drive is None else drive.profile
    return _spans(len(made.table.variables), bool(made.faults), profile)


@cache
def _spans(variables: int, faults: bool, profile: str | None) -> list[layout.Span]:
    more = layout.NO_DRIVE
    if profile is not None:
        more = layout.OF_DRIVE if profile == "cia402" else layout.OF_ROBOT
    return layout.spans(variables, faults, more)


def why_none(made: Plan, state: bytes) -> str:
    """Return why nothing goes on from the state of a keyframe, in words; "" if a node can.

    What laws and frames give may be any number, or none; what they and the loop count with may not.
    """
    if what := layout.impossible(held_spans(made), state):
        return f"{what}, which no run has"
    values = np.frombuffer(state, "<f8", len(made.table.variables))
    spoiled = {one.target for one in made.faults if one.group == Seam.VALUES}
    for i, (variable, value) in enumerate(zip(made.table.variables, values, strict=True)):
        low, high = (
            (variable.low, variable.high) if variable.kind == "parameter" else (-_LARGEST, _LARGEST)
        )
        can_be = max(low, -_LARGEST) <= value <= min(high, _LARGEST) or i in spoiled
        can_be |= variable.kind in _ANY_NUMBER and variable.writer != "drive"
        if not (can_be or variable.timing or value == made.values.get(i)):
            why = "a law need not survive" if variable.kind == "state" else "no run has"
            return f"{variable.name} is {value:g}, which {why}"
    return ""


def differences(made: Plan, one: bytes, other: bytes) -> Iterator[tuple[str, Any, Any]]:
    """Yield name and both values where two states of a node differ, what was measured aside."""
    held, variables = held_spans(made), made.table.variables
    both = zip(layout.fields(held, one), layout.fields(held, other), strict=True)
    for (record, name, old), (_, _, new) in both:
        if name in (_MEASURED if record == "control" else ()) or old.tobytes() == new.tobytes():
            continue
        for i in (i for i in range(len(old)) if old[i].tobytes() != new[i].tobytes()):
            if record:
                yield f"{record}.{name}[{i}]", old[i].item(), new[i].item()
            elif not variables[i].timing and variables[i].name not in _REFUSALS:
                yield variables[i].name, float(old[i]), float(new[i])


def restore(made: Plan, loop: Loop, frame: Keyframe) -> None:
    """Let a node, as it was installed, stand behind the cycle of a keyframe."""
    layout.restore(loop, held_spans(made), frame.state)
    loop.k, loop.passes = frame.cycle + 1, frame.passes + 1
    loop.keep.next = frame.passes + loop.keep.every if loop.keep.every else -1
