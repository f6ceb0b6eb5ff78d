"""Why a node faulted, in words: the fault's name, and what it was about where that is known."""

from collections.abc import Mapping
from typing import Any

from pcpc.drivers import can_id
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.supervisor import ANOTHER_SENDER, INTRUSION, REPEATED_INPUT


def reason(description: Mapping[str, Any], control: Any) -> str:
    """Return the reason of the fault in a block's `control`."""
    fault = int(control[sh.FAULT])
    if fault == ANOTHER_SENDER and int(control[sh.CULPRIT]) & can_id.ID >= sh.GREETING:
        return "the other node has another plant: rig, --set, seed or a law's file differ"
    if fault == ANOTHER_SENDER:
        return f"another sender of {_culprit(description, control)} is on this bus"
    if fault == REPEATED_INPUT:
        what = "was repeated again and again: another sender of it is on this bus"
        return f"{_culprit(description, control)} {what}"
    if fault == INTRUSION:
        return f"{_culprit(description, control)} comes from two senders"
    return str(description["fault_names"][fault])


def frame_text(word: int, name: str) -> str:
    """Return a frame as users know it: 0x080 (SYNC)."""
    return f"0x{can_id.text_of(word)} ({name})"


def _culprit(description: Mapping[str, Any], control: Any) -> str:
    word = int(control[sh.CULPRIT])
    return frame_text(word, description["frames"].get(str(word & can_id.ID), "?"))
