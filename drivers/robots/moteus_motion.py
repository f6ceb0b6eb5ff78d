"""What moves a moteus: the commands of a mode, and the loop of the position.

    T = I + Kp kp (q_d - q) + Kd kd (w_d - w) + t,   |T| <= T_max                             (1)
    I' = Ki (q_d - q),  |I| <= I_max                                                          (2)

Kd is the gain of the velocity, Kp = Kd Kq and Ki = Kp Ki' with Kq, Ki' of the position and the
integral; kp, kd are the command's. q_d goes on at w_d from where it is if the position is NaN, else
from that position; with a limit of velocity or acceleration it gets there first.

    zero velocity   Kd kd (0 - w)           current   k i        brake, stopped, fault   0
    stay within     (1) outside of the bounds, t within them

A fault and the time-out are left by STOPPED alone; the time-out does what its setting says. Brake
has a command of 0: windings in short-circuit, where that is a voltage.
"""

import math

from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.drive.ways import braking_velocity, toward
from pcpc.drivers.robots.fields import FINITE
from pcpc.drivers.robots.layout import Mistake, Robot
from pcpc.drivers.robots.loops import start_here, velocity_gain
from pcpc.drivers.robots.moteus_registers import (
    ACTIVE,
    COMMANDS,
    Key,
    MoteusFault,
    MoteusMode,
)


@loop_function
def boot(r: Robot) -> None:
    """Be as after power-on."""
    x = r.state
    x.boots += 1
    x.power, x.errors, x.offset, x.torque = MoteusMode.STOPPED, MoteusFault.NONE, 0.0, 0.0
    start_here(r)


@loop_inline
def usual(value: float, default: float) -> float:
    """Return a value, for NaN its default."""
    return value if abs(value) < FINITE else default


@loop_function
def obey(r: Robot, mode: int) -> None:
    """Be in a mode, with the commands that came; out of a fault or time-out only by stopping."""
    x, v = r.state, r.value
    if mode == MoteusMode.STOPPED:
        x.power, x.errors, x.torque = MoteusMode.STOPPED, MoteusFault.NONE, 0.0
        start_here(r)
        return
    if x.power == MoteusMode.FAULT or x.power == MoteusMode.TIMEOUT:
        r.mistakes[Mistake.COMMAND_REFUSED] += 1
        return
    low, high = v[Key.POSITION_MIN], v[Key.POSITION_MAX]
    bounded = mode == MoteusMode.POSITION and v[Key.IGNORE_POSITION_BOUNDS] == 0.0
    if bounded and x.power == MoteusMode.STOPPED and (x.position < low or x.position > high):
        fail(r, MoteusFault.OUTSIDE_LIMIT)
        return
    limited = abs(v[Key.VELOCITY_LIMIT]) < FINITE or abs(v[Key.ACCEL_LIMIT]) < FINITE
    if mode == MoteusMode.POSITION and limited and abs(v[Key.STOP_POSITION]) < FINITE:
        fail(r, MoteusFault.STOP_POSITION)
        return
    if x.power != mode:
        velocity = x.velocity
        start_here(r)
        x.way_velocity = velocity
    x.power, x.fed_at = mode, r.k
    for i in range(COMMANDS):
        v[ACTIVE + i] = v[i]
    take_target(r, bounded)


@loop_function
def take_target(r: Robot, bounded: bool) -> None:
    """Take what the commands aim at."""
    x, v = r.state, r.value
    position, stop = v[Key.POSITION], v[Key.STOP_POSITION]
    x.target_velocity, x.target_torque = (
        usual(v[Key.VELOCITY], 0.0),
        usual(v[Key.FEEDFORWARD_TORQUE], 0.0),
    )
    x.result = 0
    if abs(position) < FINITE:
        x.target_position, x.result = position, 1
    elif abs(stop) < FINITE:
        speed = abs(x.target_velocity)
        x.target_velocity = speed if stop >= x.way_position else -speed
    x.arrived = 0
    outside = position < v[Key.POSITION_MIN] or position > v[Key.POSITION_MAX]
    r.mistakes[Mistake.TARGET_CLIPPED] += 1 if bounded and outside else 0


@loop_function
def fail(r: Robot, fault: int) -> None:
    """Have a fault: no torque until it is stopped."""
    r.state.power, r.state.errors = MoteusMode.FAULT, fault
    r.mistakes[Mistake.COMMAND_REFUSED] += 1


@loop_function
def damping(r: Robot) -> float:
    """Return Kd kd of (1)."""
    return velocity_gain(r) * usual(r.value[ACTIVE + Key.KD_SCALE], 1.0)


@loop_function
def stiffness(r: Robot) -> float:
    """Return Kp kp of (1)."""
    gain = velocity_gain(r) * r.gains.position_per_s
    return gain * usual(r.value[ACTIVE + Key.KP_SCALE], 1.0)


@loop_function
def torque_of(r: Robot, stiff: float) -> float:
    """Return T of (1) and do a step of (2); `stiff` 0: damping only."""
    x, v = r.state, r.value
    torque_limit = v[Key.MAX_CURRENT_A] * v[Key.TORQUE_CONSTANT]
    torque_limit = min(abs(usual(v[ACTIVE + Key.MAXIMUM_TORQUE], torque_limit)), torque_limit)
    e, torque = x.way_position - x.position, damping(r) * (x.way_velocity - x.velocity)
    if stiff != 0:
        gain = velocity_gain(r) * r.gains.position_per_s
        limit = v[Key.PID_POSITION_ILIMIT] * abs(usual(v[ACTIVE + Key.ILIMIT_SCALE], 1.0))
        limit = min(limit, torque_limit)
        x.integral += gain * r.gains.integral_per_s * e / r.rate_hz
        x.integral = min(max(x.integral, -limit), limit)
        torque += x.integral + stiffness(r) * e + x.target_torque
    return min(max(torque, -torque_limit), torque_limit)


@loop_function
def limit_of(r: Robot, key: int, default: float) -> float:
    """Return a limit of the way; NaN: there is none. Below 0 there is none either."""
    limit = usual(r.value[ACTIVE + key], r.value[default])
    return limit if limit >= 0.0 else math.nan


@loop_function
def advance_way(r: Robot, dt: float) -> None:
    """Advance q_d and w_d to the next cycle."""
    x, v = r.state, r.value
    velocity_limit = limit_of(r, Key.VELOCITY_LIMIT, Key.DEFAULT_VELOCITY_LIMIT)
    a = limit_of(r, Key.ACCEL_LIMIT, Key.DEFAULT_ACCEL_LIMIT)
    limited, ramped = velocity_limit == velocity_limit, a == a
    w, velocity_limit = x.target_velocity, velocity_limit if limited else FINITE
    w = min(max(w, -velocity_limit), velocity_limit)
    distance, before = x.target_position - x.way_position, x.way_velocity
    if x.result == 0:
        x.way_velocity = toward(before, w, a * dt) if ramped else w
        x.arrived = 1 if x.way_velocity == w else 0
    elif not limited and not ramped:
        x.way_position, x.way_velocity, x.result, x.arrived = x.target_position, w, 0, 1
    elif ramped:
        goal = w + braking_velocity(distance, FINITE, a, dt)
        x.way_velocity = toward(before, min(max(goal, -velocity_limit), velocity_limit), a * dt)
        by = abs(x.way_velocity - w)
        if (abs(distance) <= by * dt and by <= 2.0 * a * dt) or (distance == 0.0 and by <= a * dt):
            x.way_position, x.way_velocity, x.result, x.arrived = x.target_position, w, 0, 1
    elif abs(distance) <= velocity_limit * dt:
        x.way_position, x.way_velocity, x.result, x.arrived = x.target_position, w, 0, 1
    else:
        x.way_velocity = velocity_limit if distance > 0.0 else -velocity_limit
    x.way_position += x.way_velocity * dt
    x.target_position += w * dt if x.result != 0 else 0.0
    slip, stop = v[Key.MAX_POSITION_SLIP], v[ACTIVE + Key.STOP_POSITION]
    if slip >= 0.0:
        x.way_position = min(max(x.way_position, x.position - slip), x.position + slip)
    beyond = x.way_position - stop
    if (beyond > 0.0 and x.way_velocity > 0.0) or (beyond < 0.0 and x.way_velocity < 0.0):
        x.way_position, x.way_velocity, x.target_velocity = stop, 0.0, 0.0
        x.result, x.arrived = 0, 1
    keep_within(r)


@loop_function
def keep_within(r: Robot) -> None:
    """Let q_d be within the bounds of the position."""
    x, low, high = r.state, r.value[Key.POSITION_MIN], r.value[Key.POSITION_MAX]
    if r.value[ACTIVE + Key.IGNORE_POSITION_BOUNDS] != 0.0:
        return
    if x.way_position < low:
        x.way_position, x.way_velocity = low, 0.0
    elif x.way_position > high:
        x.way_position, x.way_velocity = high, 0.0


@loop_function
def watch(r: Robot) -> None:
    """Be in the time-out if the master was silent for too long."""
    x = r.state
    patience = r.value[ACTIVE + Key.WATCHDOG_TIMEOUT]
    if patience == 0.0:
        patience = r.value[Key.DEFAULT_TIMEOUT_S]
    waits = x.power == MoteusMode.POSITION or x.power == MoteusMode.ZERO_VELOCITY
    waits = waits or x.power == MoteusMode.STAY_WITHIN
    if waits and r.k - x.fed_at > patience * r.rate_hz:
        r.mistakes[Mistake.SILENT] += 1
        x.power, x.integral, x.target_velocity, x.target_torque = MoteusMode.TIMEOUT, 0.0, 0.0, 0.0
        x.way_position, x.result = x.position, 0


@loop_function
def stay_within(r: Robot) -> None:
    """Push back what is outside of the bounds; within them only what is fed forward acts."""
    x, low, high = r.state, r.value[ACTIVE + Key.LOWER_BOUND], r.value[ACTIVE + Key.UPPER_BOUND]
    x.way_position, x.way_velocity = x.position, x.velocity
    if x.position < low or x.position > high:
        x.way_position, x.way_velocity = low if x.position < low else high, 0.0
    else:
        x.integral = 0.0
    x.torque = torque_of(r, 1)


@loop_function
def work(r: Robot) -> int:
    """Do a cycle, to the torque."""
    x, v = r.state, r.value
    if x.boots == 0:
        boot(r)
    watch(r)
    mode = x.power
    if mode == MoteusMode.TIMEOUT:
        mode = int64(v[Key.TIMEOUT_MODE])
    x.torque = 0.0
    if mode == MoteusMode.POSITION:
        advance_way(r, 1.0 / r.rate_hz)
        x.torque = torque_of(r, 1)
    elif mode == MoteusMode.ZERO_VELOCITY:
        x.way_position, x.way_velocity = x.position, 0.0
        x.torque = torque_of(r, 0)
    elif mode == MoteusMode.STAY_WITHIN:
        stay_within(r)
    elif mode == MoteusMode.CURRENT:
        most = v[Key.MAX_CURRENT_A]
        current = min(max(usual(v[ACTIVE + Key.Q_CURRENT], 0.0), -most), most)
        x.torque = current * v[Key.TORQUE_CONSTANT]
    return int64(0)
