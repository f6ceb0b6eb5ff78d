"""The node as a drive on the bus: status word of CiA 402, error code and register of CiA 301.

    INIT        not ready to switch on; after a reset switch on disabled
    READY       ready to switch on; switched on while the gain falls because it was disarmed
    RUN, HOLD   operation enabled; switched on while the gain rises after a reset; quick stop active
                on the ramp at the end
    FAULT       fault reaction active on the ramp, then fault
    STOP        switch on disabled

Beside the state the word has bit 7, warning: HOLD; and bit 11, internal limit active: a value sent
in the previous cycle was clamped. The error code is 0 without a fault. An emergency frame carries
code and register; it is sent when the code changes.
"""

from typing import Any

from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.executive.loop.faults import ERROR_CODES, ERROR_REGISTERS
from pcpc.executive.loop.limits import settled
from pcpc.executive.loop.states import State
from pcpc.executive.loop.variables import CLAMPED, ERROR_CODE, ERROR_REGISTER, STATUS_WORD

NOT_READY_TO_SWITCH_ON, SWITCH_ON_DISABLED, READY_TO_SWITCH_ON, SWITCHED_ON = 0, 0x40, 0x21, 0x23
OPERATION_ENABLED, QUICK_STOP_ACTIVE, FAULT_REACTION_ACTIVE, FAULT = 0x27, 0x07, 0x0F, 0x08
WARNING, LIMIT_ACTIVE = 0x80, 0x800


@loop_function
def drive_state(n: Any, state: Any) -> Any:
    """Return the word of CiA 402's state in `state` of the supervisor."""
    guard = n.guard
    if state == State.STOP:
        return SWITCH_ON_DISABLED
    if state == State.FAULT:
        safe = guard.gain <= 0.0 and settled(n.limits)
        return FAULT if safe else FAULT_REACTION_ACTIVE
    if state == State.INIT:
        return NOT_READY_TO_SWITCH_ON if n.control.fault == 0 else SWITCH_ON_DISABLED
    if state == State.READY and guard.disarmed != 0:
        return SWITCHED_ON if guard.gain > 0.0 else READY_TO_SWITCH_ON
    if guard.pace > 0.0:
        return QUICK_STOP_ACTIVE
    if state == State.READY:
        return READY_TO_SWITCH_ON
    return OPERATION_ENABLED if guard.gain >= 1.0 else SWITCHED_ON


@loop_inline
def tell_drive(n: Any, state: Any) -> None:
    """Write status word, error code and error register."""
    word = drive_state(n, state)
    word |= WARNING if state == State.HOLD else 0
    word |= LIMIT_ACTIVE if n.v[CLAMPED] != 0.0 else 0
    n.v[STATUS_WORD] = word
    n.v[ERROR_CODE] = ERROR_CODES[n.guard.faulted]
    n.v[ERROR_REGISTER] = ERROR_REGISTERS[n.guard.faulted]
