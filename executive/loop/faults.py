"""The faults of a node: what each says, when it is noticed, what follows; why one came.

From here come the C of a device (`tools.make.generate.declared`) and the table of the docs.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcpc.drivers.can import can_id
from pcpc.drivers.canopen.layout import ErrorCode
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.executive.loop.control import Control
from pcpc.executive.loop.shared import GREETING

RAMP = "ramp"
QUICK = "quick stop"
END = "the node ends with its safe values"
DIES = "the node ends; the watchdog of the other one acts"


class Fault(NumberedEnum):
    """A named fault: what it says, the cycles in which it is noticed, what follows.

    `within` may be a key of the rig; without one, a time of its own is in `why`. `code` is
    that of CiA 301's emergency frame.
    """

    says: str
    within: int | str | None
    reaction: str
    why: str
    code: ErrorCode

    def __new__(
        cls,
        says: str,
        within: int | str | None,
        reaction: str,
        why: str = "",
        code: ErrorCode = ErrorCode.SOFTWARE,
    ) -> "Fault":
        """Return the next member."""
        fault = int.__new__(cls, len(cls.__members__))
        fault._value_ = int(fault)
        fault.says, fault.within, fault.reaction, fault.why = says, within, reaction, why
        fault.code = code
        return fault

    # fmt: off
    NONE = "none", None, "none", "", ErrorCode.NONE
    INPUT_MISSING = (
        "no valid input frame for the rig's limit of cycles", "supervisor.fault_after_cycles", RAMP,
        "", ErrorCode.SILENCE)
    COMMAND_NOT_FINITE = (
        "a command was not a finite number", 1, RAMP, "its last value is sent in that cycle")
    PEER_SILENT = (
        "the other node fell silent", None, END, "without a clock, after 5 s",
        ErrorCode.SILENCE)
    BUS_FAILED = "the bus failed", 1, RAMP, "as told by the system", ErrorCode.BUS
    OVERRUN = (
        "cycles ran past their end, more in a row than the rig allows", "overrun.fault_after", RAMP)
    ANOTHER_SENDER = (
        "another sender of one of its frames is on the bus", 3, RAMP, "3 frames in 10 cycles",
        ErrorCode.COLLISION)
    REPEATED_INPUT = (
        "an awaited frame was repeated again and again: somebody else sends it", 10, RAMP,
        "10 frames in 100 cycles", ErrorCode.PROTOCOL)
    OUTPUT_NOT_FINITE = "an output was not a finite number", 1, RAMP
    PLANT_NOT_FINITE = "the plant diverged: an output was not a finite number", 1, RAMP
    STEP_RAISED = "a step ended with an exception", 1, DIES, "", ErrorCode.LAW
    STEP_HANGS = "a step does not return", None, DIES, "after 3 s or 20 periods", ErrorCode.LAW
    EMERGENCY_STOP = "the emergency stop is pressed", 1, QUICK, "", ErrorCode.EXTERNAL
    STOP_FRAME = "a stop frame came", 1, QUICK, "", ErrorCode.EXTERNAL
    NOT_PLAUSIBLE = (
        "received values were not plausible", "supervisor.fault_after_cycles", RAMP,
        "or the signal's fault_after, in a row", ErrorCode.SENSOR)
    INTRUSION = (
        "a frame comes from two senders", 3, RAMP,
        "1 or 3 signs, if `supervisor.intrusion` says so", ErrorCode.COLLISION)
    BUS_OFF = (
        "the CAN controller went bus-off", 1, RAMP, "as told by an error frame",
        ErrorCode.BACK_FROM_OFF)
    # fmt: on


FAULT_NAMES = tuple(fault.says for fault in Fault)
ERROR_CODES = np.array([float(fault.code) for fault in Fault])
ERROR_REGISTERS = np.array([float(fault.code.register) for fault in Fault])


def reason(description: Mapping[str, Any], control: Control) -> str:
    """Return the reason of the fault in a block's `control`."""
    fault = int(control.fault)
    if fault == Fault.ANOTHER_SENDER and int(control.culprit) & can_id.ID >= GREETING:
        return "the other node has another plant: rig, --set, seed or a law's file differ"
    if fault == Fault.ANOTHER_SENDER:
        return f"another sender of {_culprit(description, control)} is on this bus"
    if fault == Fault.REPEATED_INPUT:
        what = "was repeated again and again: another sender of it is on this bus"
        return f"{_culprit(description, control)} {what}"
    if fault == Fault.INTRUSION:
        return f"{_culprit(description, control)} comes from two senders"
    if fault == Fault.PEER_SILENT and int(control.culprit):
        return f"{description['fault_names'][fault]}: no {_culprit(description, control)} came"
    return str(description["fault_names"][fault])


def frame_text(word: int, name: str) -> str:
    """Return a frame as users know it: 0x080 (SYNC)."""
    return f"0x{can_id.text_of(word)} ({name})"


def _culprit(description: Mapping[str, Any], control: Control) -> str:
    word = int(control.culprit)
    return frame_text(word, description["frames"].get(str(word & can_id.ID), "?"))
