"""What moves the motor: a profile in each mode, a position and a velocity loop, limits.

    position   w_d = v + Kp (q_d - q)                                                        (1)
    velocity   u   = Kv (w_d - w + Ki int (w_d - w) dt),   |u| <= u_rated max_torque         (2)

    mode                 q_d, v and w_d
    profile position     v = the fastest that still stops at the target, d ahead, in m more  (3)
                         cycles of the deceleration: v = d/((m + 1) T) + m a T/2,
                         m the whole part of (sqrt(1 + 8 d/(a T^2)) - 1)/2
    profile velocity     w_d goes to the target with acceleration or deceleration
    cyclic position      q_d goes to the target in the period of 0x60C2, v = 0
    cyclic velocity      w_d = target
    cyclic torque        u = target torque, without (1) and (2)
    homing               35, 37: where the motor stands has the position home offset, as with
                         many drives; in CiA 402's text zero lies at home plus offset, so that
                         the motor would stand at the negative offset

    quick stop, fault, halt   w_d goes to 0; the motor is then off, or stands

The integral stands while u is limited and would grow further. u is the command of the rig's plant,
u_rated its value at 100 %; q and w are in the plant's units. Source: CiA 402-2, 10 to 17.
"""

import math

from pcpc.drivers.canopen.layout import (
    Canopen,
    ErrorCode,
    ErrorRegister,
    Mistake,
    Od,
    OperationMode,
    Power,
)
from pcpc.drivers.canopen.network import mode_to_be
from pcpc.drivers.canopen.power import (
    end_ramp,
    fail,
    has_power,
    obey,
    tell_status,
)
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.drive.ways import toward

NEW_SETPOINT, AT_ONCE, RELATIVE, HALT = 1 << 4, 1 << 5, 1 << 6, 1 << 8
LARGEST, FINITE = 2147483647.0, 1e300  # beyond FINITE the last measured value stays
NO_WINDOW, ROUNDING = 0xFFFF_FFFF, 1.0 + 1e-9
FIRST_SLOW = 1, 5  # options that take the deceleration of the profile


@loop_inline
def raw_of(x: float, scale: float) -> int:
    """Return a value in increments, the nearest that 32 bits hold."""
    r = x * scale
    if not abs(r) < LARGEST:
        return int64(LARGEST) if r > 0.0 else int64(-LARGEST)
    return int64(r + 0.5) if r >= 0.0 else -int64(0.5 - r)


@loop_inline
def position_of(d: Canopen, row: int) -> float:
    """Return an object of a position or its acceleration in the plant's unit."""
    return d.value[row] / d.position_scale


@loop_inline
def velocity_of(d: Canopen, row: int) -> float:
    """Return an object of a velocity in the plant's unit."""
    return d.value[row] / d.velocity_scale


@loop_function
def begin_mode(d: Canopen) -> None:
    """Begin where the motor is."""
    x = d.state
    x.demand_position, x.demand_velocity, x.integral = x.position, x.velocity, 0.0
    x.target, x.moves, x.pends, x.acknowledged = x.position, 0, 0, 0
    x.reached, x.behind_since, x.near_since = 0, -1, -1
    x.wanted, x.steps_left = d.value[Od.POSITION_ACTUAL], 0


@loop_inline
def within_limits(d: Canopen, q: float) -> float:
    """Return a position within the limits of object 0x607D."""
    low, high = position_of(d, Od.LIMIT_LOW), position_of(d, Od.LIMIT_HIGH)
    value = min(max(q, low), high) if low < high else q
    if value != q:
        d.state.limited = 1
    return value


@loop_function
def take_setpoint(d: Canopen) -> None:
    """Take a new target with the edge of bit 4; one more waits, unless it is wanted at once."""
    x, word = d.state, d.value[Od.CONTROLWORD]
    if word & NEW_SETPOINT != 0 and x.word_before & NEW_SETPOINT == 0 and x.pends == 0:
        base = 0.0
        if word & RELATIVE != 0:
            base = x.target if x.moves != 0 else x.demand_position
        asked = position_of(d, Od.TARGET_POSITION) + base
        goal = within_limits(d, asked)
        d.mistakes[Mistake.TARGET_CLIPPED] += 1 if goal != asked else 0
        x.acknowledged = 1
        if word & AT_ONCE != 0 or x.moves == 0:
            x.target, x.moves = goal, 1
        else:
            x.pending, x.pends = goal, 1
    elif word & NEW_SETPOINT == 0 and x.pends == 0:
        x.acknowledged = 0
    if x.moves == 0 and x.pends != 0:
        x.target, x.moves, x.pends = x.pending, 1, 0


@loop_inline
def fastest_that_stops(distance: float, slow: float, dt: float) -> float:
    """Return a cycle's velocity after which equal steps of deceleration end at `distance` (3)."""
    cycles = math.floor((math.sqrt(1.0 + 8.0 * distance / (slow * dt * dt)) - 1.0) / 2.0)
    return distance / ((cycles + 1.0) * dt) + 0.5 * cycles * slow * dt


@loop_function
def profile_position(d: Canopen, dt: float) -> float:
    """Advance the demand to the target (3); return the velocity that is wanted (1)."""
    x = d.state
    take_setpoint(d)
    a, slow = position_of(d, Od.ACCELERATION), position_of(d, Od.DECELERATION)
    distance = x.target - x.demand_position
    fastest = min(
        fastest_that_stops(abs(distance), slow, dt),
        velocity_of(d, Od.PROFILE_VELOCITY),
        velocity_of(d, Od.MAX_PROFILE_VELOCITY),
    )
    if d.value[Od.CONTROLWORD] & HALT != 0:
        fastest = 0.0
    goal = fastest if distance > 0.0 else -fastest
    grows = abs(goal) > abs(x.demand_velocity)
    v = toward(x.demand_velocity, goal, (a if grows else slow) * dt)
    stops = abs(v) <= slow * dt * ROUNDING  # in the next cycle
    if x.moves != 0 and stops and abs(distance - v * dt) <= abs(distance) * (ROUNDING - 1.0):
        x.demand_position, x.moves = x.target, 0
    else:
        x.demand_position += v * dt
    x.demand_velocity = v
    near = abs(raw_of(x.target - x.position, d.position_scale))
    judge_reached(d, x.moves == 0 and near <= d.value[Od.POSITION_WINDOW], Od.POSITION_MS)
    return v + d.gains.position_per_s * (x.demand_position - x.position)


@loop_function
def judge_reached(d: Canopen, near: bool, row: int) -> None:
    """Let the target be reached once it has been near for the time of an object, ms."""
    x = d.state
    if not near:
        x.near_since, x.reached = -1, 0
        return
    if x.near_since < 0:
        x.near_since = d.k
    x.reached = 1 if d.k - x.near_since >= d.value[row] * 1e-3 * d.rate_hz else 0


@loop_function
def profile_velocity(d: Canopen, dt: float) -> float:
    """Return the velocity that is wanted: on its way to the target."""
    x, most = d.state, velocity_of(d, Od.MAX_PROFILE_VELOCITY)
    goal = min(max(velocity_of(d, Od.TARGET_VELOCITY), -most), most)
    if d.value[Od.CONTROLWORD] & HALT != 0:
        goal = 0.0
    grows = abs(goal) > abs(x.demand_velocity)
    row = Od.ACCELERATION if grows else Od.DECELERATION
    x.demand_velocity = toward(x.demand_velocity, goal, position_of(d, row) * dt)
    off = abs(raw_of(goal - x.velocity, d.velocity_scale))
    judge_reached(d, off <= d.value[Od.VELOCITY_WINDOW], Od.VELOCITY_MS)
    return x.demand_velocity


@loop_function
def interpolate(d: Canopen) -> None:
    """Bring the demand to a new target in equal steps over the period of object 0x60C2."""
    x = d.state
    goal = within_limits(d, position_of(d, Od.TARGET_POSITION))
    if d.value[Od.TARGET_POSITION] != x.wanted:
        clipped = goal != position_of(d, Od.TARGET_POSITION)
        d.mistakes[Mistake.TARGET_CLIPPED] += 1 if clipped else 0
        x.wanted = d.value[Od.TARGET_POSITION]
        cycles = d.value[Od.PERIOD] * d.rate_hz
        for _ in range(-d.value[Od.PERIOD_EXPONENT]):
            cycles = cycles / 10.0
        x.steps_left = max(int64(cycles + 0.5), 1)
        x.target = goal
        x.step = (x.target - x.demand_position) / x.steps_left
    if x.steps_left > 0:
        x.steps_left -= 1
        x.demand_position += x.step
        if x.steps_left == 0:
            x.demand_position = x.target


@loop_function
def go_home(d: Canopen) -> None:
    """With the edge of bit 4, let where the motor stands be the home offset."""
    x, word = d.state, d.value[Od.CONTROLWORD]
    if word & NEW_SETPOINT != 0 and x.word_before & NEW_SETPOINT == 0:
        x.offset += position_of(d, Od.HOME_OFFSET) - x.position
        x.position = position_of(d, Od.HOME_OFFSET)
        x.demand_position, x.homed, x.reached = x.position, 1, 1
    elif word & NEW_SETPOINT == 0:
        x.homed = 0


@loop_function
def limited_command(d: Canopen, u: float) -> float:
    """Return a command within the largest torque; note if it was larger."""
    limit = d.rated * d.value[Od.MAX_TORQUE] * 1e-3
    if abs(u) > limit:
        d.state.limited = 1
    return min(max(u, -limit), limit)


@loop_function
def follow_velocity(d: Canopen, wanted: float, dt: float) -> float:
    """Return the command of the velocity loop (2)."""
    x, g = d.state, d.gains
    e = wanted - x.velocity
    u = g.velocity * (e + x.integral)
    command = limited_command(d, u)
    if command == u or u * e < 0.0:
        x.integral += g.integral_per_s * e * dt
    d.value[Od.VELOCITY_DEMAND] = raw_of(wanted, d.velocity_scale)
    return command


@loop_function
def ramp_down(d: Canopen, option: int, dt: float) -> float:
    """Return the command on the way to rest; at its end the state is left."""
    x = d.state
    slow = option in FIRST_SLOW
    rate = position_of(d, Od.DECELERATION if slow else Od.QUICK_STOP_DECELERATION)
    x.demand_velocity = toward(x.demand_velocity, 0.0, rate * dt)
    x.demand_position = x.position
    u = follow_velocity(d, x.demand_velocity, dt)
    if x.demand_velocity == 0.0:
        end_ramp(d)
    return u


@loop_function
def in_operation(d: Canopen, dt: float) -> float:
    """Return the command of the mode."""
    x = d.state
    offset = velocity_of(d, Od.VELOCITY_OFFSET)
    if x.mode == OperationMode.CYCLIC_TORQUE:
        share = (d.value[Od.TARGET_TORQUE] + d.value[Od.TORQUE_OFFSET]) * 1e-3
        x.demand_position, x.demand_velocity = x.position, x.velocity
        return limited_command(d, d.rated * share)
    wanted = 0.0
    if x.mode == OperationMode.PROFILE_POSITION:
        wanted = profile_position(d, dt)
    elif x.mode == OperationMode.PROFILE_VELOCITY:
        wanted = profile_velocity(d, dt)
        x.demand_position = x.position
    elif x.mode == OperationMode.CYCLIC_POSITION:
        interpolate(d)
        x.demand_velocity = x.velocity
        wanted = offset + d.gains.position_per_s * (x.demand_position - x.position)
    elif x.mode == OperationMode.CYCLIC_VELOCITY:
        wanted = x.demand_velocity = velocity_of(d, Od.TARGET_VELOCITY) + offset
        x.demand_position = x.position
    elif x.mode == OperationMode.HOMING:
        go_home(d)
        x.demand_velocity = 0.0
        wanted = d.gains.position_per_s * (x.demand_position - x.position)
    else:
        x.demand_velocity = 0.0
    return follow_velocity(d, wanted, dt)


@loop_function
def watch_following(d: Canopen) -> None:
    """Let a demand that is not followed for long be a fault (0x6065, 0x6066)."""
    x = d.state
    watched = x.mode == OperationMode.PROFILE_POSITION or x.mode == OperationMode.CYCLIC_POSITION
    error = raw_of(x.demand_position - x.position, d.position_scale)
    d.value[Od.FOLLOWING_ERROR] = error
    window = d.value[Od.FOLLOWING_WINDOW]
    far = watched and window != NO_WINDOW and abs(error) > window
    if x.power != Power.OPERATION_ENABLED or not far:
        x.behind_since = -1
        return
    if x.behind_since < 0:
        x.behind_since = d.k
    if d.k - x.behind_since >= d.value[Od.FOLLOWING_MS] * 1e-3 * d.rate_hz:
        fail(d, ErrorCode.FOLLOWING, ErrorRegister.MOTION)


@loop_function
def measure(d: Canopen, position: float, velocity: float) -> None:
    """Take what the sensors say, before homing; write it into its objects."""
    x = d.state
    if abs(position) < FINITE and abs(velocity) < FINITE:
        x.position, x.velocity = position + x.offset, velocity
    d.value[Od.POSITION_ACTUAL] = raw_of(x.position, d.position_scale)
    d.value[Od.VELOCITY_ACTUAL] = raw_of(x.velocity, d.velocity_scale)


@loop_function
def advance(d: Canopen) -> float:
    """Do a cycle of the drive: the states, then the command for what was measured; return it."""
    x, dt = d.state, 1.0 / d.rate_hz
    x.limited = 0
    obey(d)
    mode, enabled = mode_to_be(d), has_power(x.power)
    if mode != x.mode or (enabled and x.enabled == 0):
        x.mode = mode
        x.homed = 0
        begin_mode(d)
    x.enabled = 1 if enabled else 0
    u = 0.0
    if x.leaves != 0:
        u = ramp_down(d, FIRST_SLOW[0], dt)
    elif x.power == Power.OPERATION_ENABLED:
        u = in_operation(d, dt)
    elif x.power == Power.QUICK_STOP_ACTIVE:
        u = ramp_down(d, d.value[Od.QUICK_STOP_OPTION], dt)
    elif x.power == Power.FAULT_REACTION_ACTIVE:
        u = ramp_down(d, d.value[Od.FAULT_OPTION], dt)
    if not has_power(x.power):
        u, x.demand_position, x.demand_velocity, x.reached = 0.0, x.position, x.velocity, 0
        d.value[Od.VELOCITY_DEMAND] = 0
    watch_following(d)
    x.word_before = d.value[Od.CONTROLWORD]
    tell_demand(d, u)
    tell_status(d)
    return u


@loop_function
def tell_demand(d: Canopen, u: float) -> None:
    """Write what is demanded into its objects."""
    x, torque = d.state, raw_of(u, 1000.0 / d.rated)
    d.value[Od.MODE_DISPLAY] = x.mode
    d.value[Od.POSITION_DEMAND] = raw_of(x.demand_position, d.position_scale)
    d.value[Od.TORQUE_DEMAND] = d.value[Od.TORQUE_ACTUAL] = torque
