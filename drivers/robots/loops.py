"""What moves a robot's drive: a position and a velocity loop, in the units of its protocol.

    w_d = v + Kp (q_d - q),  |w_d| <= w_max                                                  (1)
    T   = t + Kv/(rated s) (w_d - w + Ki int (w_d - w) dt),  |T| <= T_max                     (2)
    u   = rated T                                                                             (3)

q, w, T in units of the protocol; s those of its velocity for one of the plant. Kv is in units of
the plant's command, as the gains of a drive are (`drivers.canopen.motion`), and rated is the
command for a torque of 1. The integral stands while T is limited and would grow further.
"""

from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.drive.ways import braking_velocity, toward
from pcpc.drivers.robots.fields import FINITE, is_number
from pcpc.drivers.robots.layout import Robot


@loop_function
def measure(r: Robot, position: float, velocity: float) -> None:
    """Take what the sensors say, in the plant's units."""
    x = r.state
    if abs(position) < FINITE and abs(velocity) < FINITE:
        x.position = position * r.position_scale + x.offset
        x.velocity = velocity * r.velocity_scale


@loop_function
def start_here(r: Robot) -> None:
    """Let every target be where the motor stands."""
    x = r.state
    x.target_position = x.way_position = x.position
    x.target_velocity = x.way_velocity = x.target_torque = x.way_torque = x.integral = 0.0
    x.stiffness = x.damping = 0.0
    x.arrived = 1


@loop_function
def place_at(r: Robot, position: float) -> None:
    """Let where the motor stands be `position`; targets move along."""
    x = r.state
    if is_number(r, position):
        by = position - x.position
        x.offset += by
        x.position += by
        x.target_position += by
        x.way_position += by


@loop_inline
def wanted_velocity(r: Robot, velocity_limit: float) -> float:
    """Return w_d of (1) for the way's position and velocity."""
    x = r.state
    wanted = x.way_velocity + r.gains.position_per_s * (x.way_position - x.position)
    return min(max(wanted, -velocity_limit), velocity_limit)


@loop_inline
def velocity_gain(r: Robot) -> float:
    """Return Kv/(rated s) of (2)."""
    return r.gains.velocity / (r.rated * r.velocity_scale)


@loop_function
def torque_for(r: Robot, wanted: float, torque_limit: float) -> float:
    """Return T of (2) for a velocity."""
    x, g, dt = r.state, r.gains, 1.0 / r.rate_hz
    e = wanted - x.velocity
    torque = x.way_torque + velocity_gain(r) * (e + x.integral)
    limited = min(max(torque, -torque_limit), torque_limit)
    if limited == torque or torque * e < 0.0:
        x.integral += g.integral_per_s * e * dt
    return limited


@loop_function
def follow_trapezoid(r: Robot, fast: float, up: float, down: float, inertia: float) -> None:
    """Go to the target, at most `fast`, and stop there; `up`, `down`: accelerations."""
    x, dt = r.state, 1.0 / r.rate_hz
    distance = x.target_position - x.way_position
    goal = braking_velocity(distance, fast, down, dt)
    grows = abs(goal) > abs(x.way_velocity)
    before = x.way_velocity
    x.way_velocity = toward(before, goal, (up if grows else down) * dt)
    x.way_torque = (x.way_velocity - before) / dt * inertia
    if abs(distance) <= abs(x.way_velocity) * dt and abs(x.way_velocity) <= 2.0 * down * dt:
        x.way_position, x.way_velocity, x.arrived = x.target_position, 0.0, 1
    else:
        x.way_position += x.way_velocity * dt
