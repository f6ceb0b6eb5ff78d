"""The power state machine of CiA 402: what a controlword leads to, and the statusword.

               DISABLE   QUICK     SHUTDOWN  SWITCH    ENABLE
               VOLTAGE   STOP                ON        OPERATION
      NOT      NOT       NOT       NOT       NOT       NOT          then DISABLED (1)
      DISABLED DISABLED  DISABLED  READY 2   DISABLED  DISABLED
      READY    DISABLED  DISABLED  READY     ON 3      ON 3, then ENABLED 4
      ON       DISABLED  DISABLED  READY 6   ON        ENABLED 4
      ENABLED  DISABLED  QUICK 11  READY 8   ON 5      ENABLED
      QUICK    DISABLED  QUICK     QUICK     QUICK     ENABLED 16, with quick stop option 5, 6
      REACTION REACTION ...                            then FAULT (14)
      FAULT    FAULT ...                               DISABLED (15) with the edge of fault reset

    command            bits of the controlword 7 3 2 1 0
    SHUTDOWN           0 x 1 1 0            SWITCH ON          0 0 1 1 1
    ENABLE OPERATION   0 1 1 1 1            DISABLE VOLTAGE    0 x x 0 x
    QUICK STOP         0 x 0 1 x            fault reset        0 -> 1 x x x x

    quick stop option   0 off at once; 1, 2 down, then off; 5, 6 down, then stay
    fault option        0 off at once; 1, 2 down, then off
    shutdown, disable operation option    0 at once; 1 down, with the deceleration of the profile
    lost connection     0 nothing, 1 a fault (0x8130, 0x8100), 2 off at once, 3 a quick stop
    1, 5: with the deceleration of the profile; 2, 6: with that of the quick stop

Transitions have the numbers of CiA 402. Source: CiA 402-2, IEC 61800-7-201, 6.3.
"""

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.canopen.frames import tell_error
from pcpc.drivers.canopen.layout import (
    LIMITED,
    POWER_WORDS,
    REACHED,
    REMOTE,
    VOLTAGE,
    Canopen,
    ErrorRegister,
    Mistake,
    Od,
    OperationMode,
    Power,
)
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import int64

FAULT_RESET, COMMAND_BITS = 0x80, 0x8F
FIRST_STAYING = 5  # option of the quick stop
BIT_12, BIT_13 = 1 << 12, 1 << 13
ABORT_IS_FAULT, ABORT_DISABLES, ABORT_QUICK_STOPS = 1, 2, 3  # of object 0x6007


class PowerCommand(NumberedEnum):
    """What a controlword asks for."""

    DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE_OPERATION = range(5)


def _next() -> NDArray[np.int64]:
    NOT, DISABLED, READY, ON, ENABLED, QUICK, REACTION, FAULT = Power
    return np.array(
        [
            [NOT, NOT, NOT, NOT, NOT],
            [DISABLED, DISABLED, READY, DISABLED, DISABLED],
            [DISABLED, DISABLED, READY, ON, ON],
            [DISABLED, DISABLED, READY, ON, ENABLED],
            [DISABLED, QUICK, READY, ON, ENABLED],
            [DISABLED, QUICK, QUICK, QUICK, ENABLED],
            [REACTION] * 5,
            [FAULT] * 5,
        ],
        np.int64,
    )


NEXT = _next()


@loop_inline
def command_of(word: int) -> int:
    """Return what a controlword asks for, fault reset aside."""
    if word & 2 == 0:
        return PowerCommand.DISABLE_VOLTAGE
    if word & 4 == 0:
        return PowerCommand.QUICK_STOP
    if word & 1 == 0:
        return PowerCommand.SHUTDOWN
    return PowerCommand.ENABLE_OPERATION if word & 8 != 0 else PowerCommand.SWITCH_ON


@loop_inline
def has_power(power: int) -> bool:
    """Return whether the motor is driven in a state."""
    return (
        power == Power.OPERATION_ENABLED
        or power == Power.QUICK_STOP_ACTIVE
        or power == Power.FAULT_REACTION_ACTIVE
    )


@loop_function
def next_power(power: int, word: int, before: int, option: int) -> int:
    """Return the state that follows a controlword; `before`: the one of the last cycle."""
    if power == Power.NOT_READY:
        return int64(Power.SWITCH_ON_DISABLED)
    if power == Power.FAULT:
        edge = word & FAULT_RESET != 0 and before & FAULT_RESET == 0
        return int64(Power.SWITCH_ON_DISABLED if edge else Power.FAULT)
    wanted = command_of(word)
    stays = wanted == PowerCommand.ENABLE_OPERATION and option < FIRST_STAYING
    if power == Power.QUICK_STOP_ACTIVE and stays:
        return int64(power)
    if power == Power.OPERATION_ENABLED and wanted == PowerCommand.QUICK_STOP and option == 0:
        return int64(Power.SWITCH_ON_DISABLED)
    return NEXT[power, wanted]


@loop_function
def is_ignored(power: int, word: int, option: int) -> bool:
    """Return whether a controlword asks for a transition that a state does not have.

    What asks to stay is none; nor are the bits of a fault reset, or those that want no power.
    """
    wanted = command_of(word)
    if power == Power.FAULT:
        return wanted >= PowerCommand.SHUTDOWN and word & FAULT_RESET == 0
    if power == Power.SWITCH_ON_DISABLED:
        return wanted >= PowerCommand.SWITCH_ON
    stays = wanted == PowerCommand.ENABLE_OPERATION and option < FIRST_STAYING
    return power == Power.QUICK_STOP_ACTIVE and (
        wanted == PowerCommand.SHUTDOWN or wanted == PowerCommand.SWITCH_ON or stays
    )


@loop_function
def obey(d: Canopen) -> None:
    """Go to the state that the controlword asks for, some after a ramp; a reset ends the fault."""
    x, word, option = d.state, d.value[Od.CONTROLWORD], d.value[Od.QUICK_STOP_OPTION]
    if (word ^ x.word_before) & COMMAND_BITS != 0 and is_ignored(x.power, word, option):
        d.mistakes[Mistake.COMMAND_IGNORED] += 1
    power = next_power(x.power, word, x.word_before, option)
    if x.power == Power.FAULT and power != Power.FAULT:
        tell_error(d, 0, 0)
    x.leaves = 0
    if x.power == Power.OPERATION_ENABLED and (
        (power == Power.READY_TO_SWITCH_ON and d.value[Od.SHUTDOWN_OPTION] != 0)
        or (power == Power.SWITCHED_ON and d.value[Od.DISABLE_OPTION] != 0)
    ):
        x.leaves, power = power, x.power
    x.power = power


@loop_function
def fail(d: Canopen, code: int, register: int) -> None:
    """Note a fault: an emergency, and the reaction that the rig or the master has chosen."""
    x = d.state
    if x.power == Power.FAULT or x.power == Power.FAULT_REACTION_ACTIVE:
        return
    reacts = has_power(x.power) and d.value[Od.FAULT_OPTION] != 0
    x.power = Power.FAULT_REACTION_ACTIVE if reacts else Power.FAULT
    tell_error(d, code, register)


@loop_function
def lose_connection(d: Canopen, code: int) -> None:
    """React to a master that is silent or has stopped the node, as object 0x6007 says."""
    x, option = d.state, d.value[Od.ABORT_OPTION]
    if option == ABORT_IS_FAULT:
        fail(d, code, ErrorRegister.COMMUNICATION)
    elif option == ABORT_DISABLES and has_power(x.power):
        x.power = int64(Power.SWITCH_ON_DISABLED)
    elif option == ABORT_QUICK_STOPS and x.power == Power.OPERATION_ENABLED:
        x.power = int64(Power.QUICK_STOP_ACTIVE)


@loop_function
def end_ramp(d: Canopen) -> None:
    """Leave the state of a ramp that has come to its end."""
    x = d.state
    if x.leaves != 0:
        x.power = x.leaves
    elif x.power == Power.FAULT_REACTION_ACTIVE:
        x.power = Power.FAULT
    elif x.power == Power.QUICK_STOP_ACTIVE and d.value[Od.QUICK_STOP_OPTION] < FIRST_STAYING:
        x.power = Power.SWITCH_ON_DISABLED


@loop_function
def tell_status(d: Canopen) -> None:
    """Write the statusword.

    Bit 12: setpoint acknowledged; speed 0; homing attained; the target is followed. Bit 13:
    following error.
    """
    x = d.state
    word = POWER_WORDS[x.power] | VOLTAGE | REMOTE
    word |= LIMITED if x.limited != 0 else 0
    word |= REACHED if x.reached != 0 else 0
    enabled = x.power == Power.OPERATION_ENABLED
    if x.mode == OperationMode.PROFILE_POSITION:
        word |= BIT_12 if x.acknowledged != 0 else 0
    elif x.mode == OperationMode.PROFILE_VELOCITY:
        still = abs(d.value[Od.VELOCITY_ACTUAL]) <= d.value[Od.VELOCITY_WINDOW]
        word |= BIT_12 if still else 0
    elif x.mode == OperationMode.HOMING:
        word |= BIT_12 if x.homed != 0 else 0
    elif x.mode >= OperationMode.CYCLIC_POSITION:
        word |= BIT_12 if enabled else 0
    if x.mode == OperationMode.PROFILE_POSITION or x.mode == OperationMode.CYCLIC_POSITION:
        word |= BIT_13 if x.behind_since >= 0 and enabled else 0
    d.value[Od.STATUSWORD] = word
