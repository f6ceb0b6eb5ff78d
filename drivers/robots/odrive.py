"""ODrive's CANSimple: a frame's id is node << 5 | command; numbers are float32, in turns and N m.

    00 Get_Version       01 Heartbeat *      02 Estop            03 Get_Error *
    04 RxSdo  05 TxSdo   07 Set_Axis_State   09 Get_Encoder_Estimates *
    0B Set_Controller_Mode                   0C Set_Input_Pos    0D Set_Input_Vel
    0E Set_Input_Torque  0F Set_Limits       11 Set_Traj_Vel_Limit  12 Set_Traj_Accel_Limits
    13 Set_Traj_Inertia  14 Get_Iq *         15 Get_Temperature *   16 Reboot
    17 Get_Bus_Voltage_Current *             18 Clear_Errors     19 Set_Absolute_Position
    1A Set_Pos_Gain      1B Set_Vel_Gains    1C Get_Torques *    1D Get_Powers *

* are sent by themselves with the period of their setting, if it is not 0; all that begin with Get
are also answers to a remote frame.

    IDLE 1, CLOSED_LOOP_CONTROL 8; calibrations 3, 4, 7 end at once with success, in IDLE; all
    other states are refused (INVALID_STATE). An error disarms: IDLE, no torque, until Clear_Errors.

    control mode   torque 1, velocity 2, position 3
    input mode     passthrough 1, velocity ramp 2, position filter 3, trapezoid 5, torque ramp 6
    filter         a = 1/4 k^2 (q_in - q_d) + k (v_in - v_d),  k = 2 bandwidth                (1)

A velocity beyond 1.2 vel_limit is an error. Source: ODrive's CAN protocol and its Controller, 0.6.
"""

import math

from pcpc.drivers.can.codec import four_bytes
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import LENGTH
from pcpc.drivers.compiled.structures import data_of
from pcpc.drivers.drive.layout import Whose
from pcpc.drivers.drive.outbox import put
from pcpc.drivers.drive.ways import toward
from pcpc.drivers.robots.fields import (
    is_number,
    is_taken,
    number_at,
    short_at,
    value_in,
    value_word,
    word_of,
    write,
)
from pcpc.drivers.robots.layout import Mistake, Robot
from pcpc.drivers.robots.loops import (
    follow_trapezoid,
    place_at,
    start_here,
    torque_for,
    velocity_gain,
    wanted_velocity,
)
from pcpc.drivers.robots.odrive_settings import (
    LENGTHS,
    OWN,
    SENT,
    SETS,
    Axis,
    CommandId,
    Control,
    Error,
    Input,
    Key,
    ProcedureResult,
)

NODES = 64
PROTOCOL, FIRMWARE = 2, (0, 6, 10)
_LONG_AGO = 1 << 40  # cycles
_REMOTE = int64(1 << 30)


@loop_function
def boot(r: Robot) -> None:
    """Be as after power-on; the offset of the position is lost."""
    x = r.state
    x.boots += 1
    x.power, x.errors, x.disarmed_by, x.result = (
        Axis.IDLE,
        Error.NONE,
        Error.NONE,
        ProcedureResult.SUCCESS,
    )
    x.offset = x.torque = 0.0
    for i in range(r.n):
        r.value[i] = r.settings[i].start
    for i in range(len(SENT)):
        r.sent_at[i] = r.k - _LONG_AGO  # all are sent at once
    start_here(r)


@loop_function
def disarm(r: Robot, error: int) -> None:
    """Note an error; without torque from now on."""
    x = r.state
    x.errors |= error
    if x.power == Axis.CLOSED_LOOP:
        x.power, x.disarmed_by, x.result = Axis.IDLE, error, ProcedureResult.DISARMED


@loop_function
def hear(r: Robot) -> int:
    """Take the frame in `rx`; return whose it is."""
    if r.state.boots == 0:
        boot(r)
    can_id = four_bytes(r.rx, 0)
    remote, number = can_id & _REMOTE != 0, can_id & ~_REMOTE
    if number >> 5 != r.node:
        return int64(Whose.OTHER)
    command = number & 31
    if remote:
        answer(r, command)
    elif OWN[command] != 0:
        return int64(Whose.TWIN)
    elif r.rx[LENGTH] < LENGTHS[command]:
        r.mistakes[Mistake.FRAME_SHORT] += 1
    else:
        obey(r, command, data_of(r.rx))
    return int64(Whose.OURS)


@loop_function
def obey(r: Robot, command: int, data: Cells[Byte]) -> None:
    """Do what a frame wants."""
    x = r.state
    if command == CommandId.ESTOP:
        disarm(r, Error.ESTOP)
    elif command == CommandId.READ_OR_WRITE:
        serve(r, data)
    elif command == CommandId.STATE:
        ask_for(r, four_bytes(data, 0))
        x.fed_at = r.k
    elif CommandId.POSITION <= command <= CommandId.TORQUE:
        take_input(r, command, data)
        x.fed_at = r.k
    elif SETS[command, 0] >= 0:
        write_both(r, command, data)
    elif command == CommandId.REBOOT and (data[0] == 0 or data[0] == 2):
        boot(r)
    elif command == CommandId.CLEAR:
        x.errors = Error.NONE
    elif command == CommandId.ABSOLUTE:
        place_at(r, number_at(data, 0))
    elif command == CommandId.POSITION_GAIN or command == CommandId.VELOCITY_GAINS:
        take_gains(r, command, data)
    else:
        r.mistakes[Mistake.COMMAND_REFUSED] += 1


@loop_function
def write_both(r: Robot, command: int, data: Cells[Byte]) -> None:
    """Give the settings of a command their values, both or none."""
    first, second, other = SETS[command, 0], SETS[command, 1], 0.0
    value = value_in(r, first, data, 0)
    if second >= 0:
        other = value_in(r, second, data, 4)
    if command == CommandId.LIMITS:
        other *= r.value[Key.TORQUE_CONSTANT]
    if not is_number(r, value) or not is_taken(r, first, value):
        return
    if second >= 0 and not write(r, second, other):
        return
    r.value[first] = value


@loop_function
def ask_for(r: Robot, state: int) -> None:
    """Go to a state of the axis, or say how that ended."""
    x = r.state
    if state == Axis.IDLE:
        x.power, x.result = Axis.IDLE, ProcedureResult.SUCCESS
    elif state == Axis.CLOSED_LOOP and x.errors != 0:
        x.result = ProcedureResult.DISARMED
        r.mistakes[Mistake.COMMAND_REFUSED] += 1
    elif state == Axis.CLOSED_LOOP:
        if x.power != Axis.CLOSED_LOOP:
            start_here(r)
        x.power, x.result = Axis.CLOSED_LOOP, ProcedureResult.SUCCESS
    elif state == 3 or state == 4 or state == 7:
        x.power, x.result = Axis.IDLE, ProcedureResult.SUCCESS
    else:
        x.result = ProcedureResult.INVALID_STATE
        r.mistakes[Mistake.COMMAND_REFUSED] += 1


@loop_function
def take_input(r: Robot, command: int, data: Cells[Byte]) -> None:
    """Take a target, with what is fed forward."""
    x, first, second, third = r.state, number_at(data, 0), 0.0, 0.0
    if command == CommandId.POSITION:
        second, third = 1e-3 * short_at(data, 4), 1e-3 * short_at(data, 6)
    elif command == CommandId.VELOCITY:
        third = number_at(data, 4)
    if not is_number(r, first) or not is_number(r, third):
        return
    if command == CommandId.POSITION:
        x.target_position, x.target_velocity, x.target_torque = first, second, third
        x.arrived = 0
    elif command == CommandId.VELOCITY:
        limit = r.value[Key.VEL_LIMIT]
        r.mistakes[Mistake.TARGET_CLIPPED] += 1 if abs(first) > limit else 0
        x.target_velocity, x.target_torque = first, third
    else:
        limit = r.value[Key.TORQUE_SOFT_MAX]
        r.mistakes[Mistake.TARGET_CLIPPED] += 1 if abs(first) > limit else 0
        x.target_torque = first


@loop_function
def take_gains(r: Robot, command: int, data: Cells[Byte]) -> None:
    """Take gains of the loops, into those of the drive."""
    first, second = number_at(data, 0), 0.0
    if command == CommandId.VELOCITY_GAINS:
        second = number_at(data, 4)
    if not is_number(r, first) or not is_number(r, second):
        return
    if first < 0.0 or second < 0.0 or first > 1e6 or second > 1e6:
        r.mistakes[Mistake.VALUE_REFUSED] += 1
        return
    r.state.regained = 1
    if command == CommandId.POSITION_GAIN:
        r.gains.position_per_s = first
        return
    r.gains.velocity = first * r.rated * r.velocity_scale
    r.gains.integral_per_s = second / first if first > 0.0 else 0.0


@loop_function
def serve(r: Robot, data: Cells[Byte]) -> None:
    """Read or write a setting by the number of its endpoint."""
    number = int64(data[1]) | int64(data[2]) << int64(8)
    if data[0] > 1 or number >= r.n:
        r.mistakes[Mistake.VALUE_REFUSED] += 1
        return
    if data[0] == 1:
        write(r, number, value_in(r, number, data, 4))
        return
    send(r, CommandId.ANSWER, number << int64(8), value_word(r, number))


@loop_function
def send(r: Robot, command: int, low: int, high: int) -> None:
    """Send one of the drive's own frames."""
    put(r, r.node << int64(5) | command, 8, low, high)


@loop_function
def answer(r: Robot, command: int) -> None:
    """Send what a command tells; a remote frame of any other is a mistake."""
    x = r.state
    if command == CommandId.VERSION:
        major, minor, patch = FIRMWARE
        send(r, command, int64(PROTOCOL), int64(major | minor << 8 | patch << 16))
    elif command == CommandId.HEARTBEAT:
        flags = x.power | x.result << int64(8) | x.arrived << int64(16)
        send(r, command, x.errors, flags)
    elif command == CommandId.ERROR:
        send(r, command, x.errors, x.disarmed_by)
    else:
        tell(r, command)


@loop_function
def tell(r: Robot, command: int) -> None:
    """Send the two numbers of a command."""
    x, v = r.state, r.value
    power = x.torque * x.velocity * 2.0 * math.pi
    first, second = x.position, x.velocity
    if command == CommandId.IQ:
        first = second = x.torque / max(v[Key.TORQUE_CONSTANT], 1e-9)
    elif command == CommandId.TEMPERATURE:
        first = second = v[Key.TEMPERATURE]
    elif command == CommandId.BUS:
        first = max(v[Key.VBUS_VOLTAGE], 1e-9)
        second = power / first
    elif command == CommandId.TORQUES:
        first, second = x.way_torque, x.torque
    elif command == CommandId.POWERS:
        first = second = power
    elif command != CommandId.ENCODER:
        r.mistakes[Mistake.COMMAND_REFUSED] += 1
        return
    send(r, command, word_of(first), word_of(second))


@loop_function
def advance_way(r: Robot, dt: float) -> bool:
    """Advance what is demanded, by the input mode; return False for a mode that is none."""
    x, v = r.state, r.value
    mode, control = int64(v[Key.INPUT_MODE]), int64(v[Key.CONTROL_MODE])
    if mode == Input.PASSTHROUGH:
        x.way_position, x.way_velocity = x.target_position, x.target_velocity
        x.way_torque = x.target_torque
    elif mode == Input.VELOCITY_RAMP and control == Control.VELOCITY:
        before = x.way_velocity
        x.way_velocity = toward(before, x.target_velocity, v[Key.VEL_RAMP_RATE] * dt)
        x.way_torque = (x.way_velocity - before) / dt * v[Key.INERTIA]
    elif mode == Input.POSITION_FILTER and control == Control.POSITION:
        k = 2.0 * min(v[Key.INPUT_FILTER_BANDWIDTH], 0.25 / dt)
        far = x.target_position - x.way_position
        a = 0.25 * k * k * far + k * (x.target_velocity - x.way_velocity)  # (1)
        x.way_velocity += a * dt
        x.way_position += x.way_velocity * dt
        x.way_torque = a * v[Key.INERTIA]
    elif mode == Input.TRAPEZOID and control == Control.POSITION:
        up, down = v[Key.TRAP_TRAJ_ACCEL_LIMIT], v[Key.TRAP_TRAJ_DECEL_LIMIT]
        follow_trapezoid(r, v[Key.TRAP_TRAJ_VEL_LIMIT], up, down, v[Key.INERTIA])
    elif mode == Input.TORQUE_RAMP and control == Control.TORQUE:
        x.way_torque = toward(x.way_torque, x.target_torque, v[Key.TORQUE_RAMP_RATE] * dt)
    else:
        return mode == Input.INACTIVE
    return True


@loop_function
def work(r: Robot) -> int:
    """Do a cycle, to the torque."""
    x, v, dt = r.state, r.value, 1.0 / r.rate_hz
    if x.boots == 0:
        boot(r)
    patience = v[Key.WATCHDOG_TIMEOUT] * r.rate_hz
    if v[Key.ENABLE_WATCHDOG] != 0.0 and x.power == Axis.CLOSED_LOOP and r.k - x.fed_at > patience:
        disarm(r, Error.WATCHDOG)
        r.mistakes[Mistake.SILENT] += 1
    velocity_limit, control = v[Key.VEL_LIMIT], int64(v[Key.CONTROL_MODE])
    velocity_bound = v[Key.VEL_LIMIT_TOLERANCE] * velocity_limit
    if x.power == Axis.CLOSED_LOOP and abs(x.velocity) > velocity_bound:
        disarm(r, Error.VELOCITY)
    if x.power == Axis.CLOSED_LOOP and (control < Control.TORQUE or not advance_way(r, dt)):
        disarm(r, Error.BAD_CONFIG)
    x.torque = 0.0
    if x.power != Axis.CLOSED_LOOP:
        x.integral, x.way_position, x.way_velocity = 0.0, x.position, 0.0
        return int64(0)
    limit = v[Key.TORQUE_SOFT_MAX]
    if control == Control.TORQUE:
        gain = velocity_gain(r)
        torque = min(
            max(x.way_torque, gain * (-velocity_limit - x.velocity)),
            gain * (velocity_limit - x.velocity),
        )
        x.torque = min(max(torque, -limit), limit)
    elif control == Control.VELOCITY:
        x.torque = torque_for(r, min(max(x.way_velocity, -velocity_limit), velocity_limit), limit)
    else:
        x.torque = torque_for(r, wanted_velocity(r, velocity_limit), limit)
    return int64(0)


@loop_function
def speak(r: Robot) -> int:
    """Send what is due."""
    for i in range(len(SENT)):
        ms = r.value[i]
        if ms > 0.0 and r.k - r.sent_at[i] >= ms * 1e-3 * r.rate_hz:
            r.sent_at[i] = r.k
            answer(r, SENT[i])
    return int64(0)
