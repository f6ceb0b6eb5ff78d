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

from pcpc.drivers.canopen.layout import LIMITED, POWER_WORDS, WARNING, Power
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.executive.loop.faults import ERROR_CODES, ERROR_REGISTERS
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.limits import settled
from pcpc.executive.loop.states import State
from pcpc.executive.loop.variables import CLAMPED, ERROR_CODE, ERROR_REGISTER, STATUS_WORD


@loop_function
def drive_state(n: Loop, state: int) -> int:
    """Return CiA 402's state in `state` of the supervisor."""
    guard = n.guard
    if state == State.STOP:
        return Power.SWITCH_ON_DISABLED
    if state == State.FAULT:
        safe = guard.gain <= 0.0 and settled(n.limits)
        return Power.FAULT if safe else Power.FAULT_REACTION_ACTIVE
    if state == State.INIT:
        return Power.NOT_READY if n.control.fault == 0 else Power.SWITCH_ON_DISABLED
    if state == State.READY and guard.disarmed != 0:
        return Power.SWITCHED_ON if guard.gain > 0.0 else Power.READY_TO_SWITCH_ON
    if guard.pace > 0.0:
        return Power.QUICK_STOP_ACTIVE
    if state == State.READY:
        return Power.READY_TO_SWITCH_ON
    return Power.OPERATION_ENABLED if guard.gain >= 1.0 else Power.SWITCHED_ON


@loop_inline
def tell_drive(n: Loop, state: int) -> None:
    """Write status word, error code and error register."""
    word = POWER_WORDS[drive_state(n, state)]
    word |= WARNING if state == State.HOLD else 0
    word |= LIMITED if n.v[CLAMPED] != 0.0 else 0
    n.v[STATUS_WORD] = word
    n.v[ERROR_CODE] = ERROR_CODES[n.guard.faulted]
    n.v[ERROR_REGISTER] = ERROR_REGISTERS[n.guard.faulted]
