"""What moves a robot's drive: a position and a velocity loop, in the units of its protocol.

    w_d = v + Kp (q_d - q),  |w_d| <= w_max                                                  (1)
    T   = t + Kv/(rated s) (w_d - w + Ki int (w_d - w) dt),  |T| <= T_max                     (2)
    u   = rated T                                                                             (3)

q, w, T in units of the protocol; s those of its velocity for one of the plant. Kv is in units of
the plant's command, as the gains of a drive are (`drivers.canopen.motion`), and rated is the
command for a torque of 1. The integral stands while T is limited and would grow further.
"""

import math

import numpy as np

from pcpc.drivers.can.codec import four_bytes
from pcpc.drivers.canopen.layout import Drive
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.robots.layout import Mistake, Robot

FINITE = 1e300
_LARGEST = 3.4028234e38  # a float32


@loop_inline
def number_at(data: Cells[Byte], at: int) -> float:
    """Return the float32 in 4 bytes of `data`."""
    word = four_bytes(data, at)
    if word >= 1 << 31:
        word -= 1 << 32
    return np.float64(np.int32(word).view(np.float32))


@loop_inline
def short_at(data: Cells[Byte], at: int) -> float:
    """Return the signed number in 2 bytes."""
    word = int64(data[at]) | int64(data[at + 1]) << int64(8)
    return np.float64(word - 65536 if word >= 32768 else word)


@loop_inline
def word_of(x: float) -> int:
    """Return a number as the 4 bytes of a float32."""
    x = min(max(x, -_LARGEST), _LARGEST)
    return int64(np.float32(x).view(np.int32)) & int64(0xFFFFFFFF)


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
def is_number(r: Robot, value: float) -> bool:
    """Return whether a value is a finite number; count it if not."""
    if abs(value) < FINITE:
        return True
    r.mistakes[Mistake.NOT_FINITE] += 1
    return False


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
def braking_velocity(distance: float, velocity_limit: float, slow: float, dt: float) -> float:
    """Return the velocity from which one, slowing down at `slow`, still stops after `distance`."""
    half = 0.5 * slow * dt
    fastest = min(math.sqrt(half * half + 2.0 * slow * abs(distance)) - half, velocity_limit)
    return fastest if distance > 0.0 else -fastest


@loop_inline
def wanted_velocity(r: Robot, d: Drive, velocity_limit: float) -> float:
    """Return w_d of (1) for the way's position and velocity."""
    x = r.state
    wanted = x.way_velocity + d.gains.position_per_s * (x.way_position - x.position)
    return min(max(wanted, -velocity_limit), velocity_limit)


@loop_function
def torque_for(r: Robot, d: Drive, wanted: float, torque_limit: float) -> float:
    """Return T of (2) for a velocity."""
    x, g, dt = r.state, d.gains, 1.0 / d.rate_hz
    e = wanted - x.velocity
    gain = g.velocity / (d.rated * r.velocity_scale)
    torque = x.way_torque + gain * (e + x.integral)
    limited = min(max(torque, -torque_limit), torque_limit)
    if limited == torque or torque * e < 0.0:
        x.integral += g.integral_per_s * e * dt
    return limited
