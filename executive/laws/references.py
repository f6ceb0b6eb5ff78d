"""Reference generators: blocks that give a desired angle and its first two derivatives.

    quintic    q = A (10 s^3 - 15 s^4 + 6 s^5), s = (t - t0)/T: up at t_up, back at t_back    (1)
    bang_bang  constant acceleration +-4 A/T^2, each for half the move                        (2)
    step       q = A from t0 on, derivatives zero                                             (3)
    sine       q = A sin(2 pi F t + phase) from t = 0 without ramp                            (4)
    triangle   +-v, legs of T_leg, first up; v is 0 before t0 and passes linearly through zero
               from T_c before each corner to T_c after it                                    (5)
    ramp       v rises linearly from 0 to V in T_r, then stays                                (6)

rad, rad/s, rad/s^2, s; in another unit: `profiles`. All are closed forms of t, so a skipped cycle
or a replay changes nothing.
"""

from pcpc.executive.laws.block import Block, Nothing, Ports, inline, port, stage
from pcpc.executive.laws.emath import floor, sincos, where

TWO_PI = 6.283185307179586


class Desired(Ports):
    """What all give."""

    q_d_rad = port("rad", "desired angle")
    q_d_rate_rad_s = port("rad/s", "its first derivative")
    q_d_acc_rad_s2 = port("rad/s2", "its second derivative")


class Amplitude(Ports):
    """Of those that know how far they go."""

    amplitude_rad = port("rad", "size of the move", None, -4.0, 4.0)


class Move(Amplitude):
    """Of those that take a time for it."""

    move_s = port("s", "duration of the move", None, 1e-3, 1e3)


class Quintic(Move):
    """Of (1)."""

    up_s = port("s", "start up", None, 0.0, 1e6)
    back_s = port("s", "start back", None, 0.0, 1e6)


class BangBang(Move):
    """Of (2)."""

    start_s = port("s", "start", None, 0.0, 1e6)


class Step(Amplitude):
    """Of (3)."""

    start_s = port("s", "time of the step", None, 0.0, 1e6)


class Sine(Amplitude):
    """Of (4)."""

    frequency_hz = port("Hz", "frequency", None, 0.0, 100.0)
    phase_rad = port("rad", "at t = 0", 0.0, -7.0, 7.0)


class Triangle(Ports):
    """Of (5)."""

    rate_rad_s = port("rad/s", "slope of the legs", None, 0.0, 10.0)
    leg_s = port("s", "duration of a leg", None, 0.0, 1e6)
    start_s = port("s", "rate is zero before", None, 0.0, 1e6)
    corner_s = port("s", "half the time in which the rate turns", None, 0.0, 1e6)


class Ramp(Ports):
    """Of (6)."""

    rate_rad_s = port("rad/s", "final rate", None, -10.0, 10.0)
    rise_s = port("s", "rise", None, 0.0, 1e6)


@inline
def within(s: float) -> float:
    """Return `s` clamped to 0..1."""
    return where(s < 0.0, 0.0, where(s > 1.0, 1.0, s))


@inline
def rise(s: float) -> tuple[float, float, float]:
    """Quintic from 0 to 1 for s in 0..1, clamped outside: value, first, second derivative."""
    s = within(s)
    s2 = s * s
    value = s2 * s * (10.0 + s * (6.0 * s - 15.0))  # (1)
    first = 30.0 * s2 * (1.0 + s * (s - 2.0))
    second = s * (60.0 + s * (120.0 * s - 180.0))
    return value, first, second


@stage
def quintic_step(t: float, dt: float, p: Quintic, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (1), up and back."""
    u0, u1, u2 = rise((t - p.up_s) / p.move_s)
    b0, b1, b2 = rise((t - p.back_s) / p.move_s)
    y.q_d_rad = p.amplitude_rad * (u0 - b0)
    y.q_d_rate_rad_s = p.amplitude_rad * (u1 - b1) / p.move_s
    y.q_d_acc_rad_s2 = p.amplitude_rad * (u2 - b2) / (p.move_s * p.move_s)


@stage
def bang_bang_step(t: float, dt: float, p: BangBang, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (2)."""
    s = within((t - p.start_s) / p.move_s)
    left = 1.0 - s
    first_half = s < 0.5
    y.q_d_rad = p.amplitude_rad * where(first_half, 2.0 * s * s, 1.0 - 2.0 * left * left)
    y.q_d_rate_rad_s = p.amplitude_rad * 4.0 * where(first_half, s, left) / p.move_s
    moving = (s > 0.0) & (s < 1.0)
    sign = where(first_half, 1.0, -1.0)
    acceleration = sign * 4.0 * p.amplitude_rad / (p.move_s * p.move_s)
    y.q_d_acc_rad_s2 = where(moving, acceleration, 0.0)


@stage
def step_step(t: float, dt: float, p: Step, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (3)."""
    y.q_d_rad = where(t < p.start_s, 0.0, p.amplitude_rad)
    y.q_d_rate_rad_s = 0.0
    y.q_d_acc_rad_s2 = 0.0


@stage
def sine_step(t: float, dt: float, p: Sine, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (4)."""
    amplitude, omega = p.amplitude_rad, TWO_PI * p.frequency_hz
    s, c = sincos(omega * t + p.phase_rad)
    y.q_d_rad = amplitude * s
    y.q_d_rate_rad_s = amplitude * omega * c
    y.q_d_acc_rad_s2 = -amplitude * omega * omega * s


@stage
def triangle_step(t: float, dt: float, p: Triangle, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (5): the area under the ramped rate, leg by leg."""
    rate, leg, start, corner = p.rate_rad_s, p.leg_s, p.start_s, p.corner_s
    n = floor(t / leg + 0.5)  # nearest corner n = 1, 2, ...; 0 before the middle of the first leg
    since = t - n * leg
    odd = n - 2.0 * floor(0.5 * n)  # 1 at an upper corner
    after = where(odd > 0.5, -rate, rate)  # rate of the leg that begins at corner n
    inside = (abs(since) < corner) & (n > 0.5)
    at_corner = where(odd > 0.5, rate * (leg - start), rate * (leg - start) - rate * leg)
    at_corner = where(n > 0.5, at_corner, -rate * start)
    # corner rounding: the rate is after*since/corner inside, so the peak is cut by rate*corner/2
    outside_q = at_corner + after * abs(since)
    inside_q = at_corner + 0.5 * after * (since * since / corner + corner)
    v = where(inside, after * since / corner, where(since < 0.0, -after, after))
    waiting = t < start
    y.q_d_rad = where(waiting, 0.0, where(inside, inside_q, outside_q))
    y.q_d_rate_rad_s = where(waiting, 0.0, v)
    y.q_d_acc_rad_s2 = where(waiting, 0.0, where(inside, after / corner, 0.0))


@stage
def ramp_step(t: float, dt: float, p: Ramp, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (6)."""
    rate, rise = p.rate_rad_s, p.rise_s
    rising = t < rise
    y.q_d_rad = where(rising, 0.5 * rate * t * t / rise, rate * (t - 0.5 * rise))
    y.q_d_rate_rad_s = where(rising, rate * t / rise, rate)
    y.q_d_acc_rad_s2 = where(rising, rate / rise, 0.0)


quintic = Block(quintic_step)
bang_bang = Block(bang_bang_step)
step = Block(step_step)
sine = Block(sine_step)
triangle = Block(triangle_step)
ramp = Block(ramp_step)
