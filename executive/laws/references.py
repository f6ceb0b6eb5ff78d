"""Reference generators: blocks that give a desired angle and its first two derivatives.

    quintic    q = A (10 s^3 - 15 s^4 + 6 s^5), s = (t - t0)/T: up at t_up, back at t_back    (1)
    bang_bang  constant acceleration +-4 A/T^2, each for half the move                        (2)
    step       q = A from t0 on, derivatives zero                                             (3)
    sine       q = A sin(2 pi F t + phase) from t = 0 without ramp                            (4)
    triangle   +-v, legs of T_leg, first up; v is 0 before t0 and passes linearly through zero
               from T_c before each corner to T_c after it                                    (5)
    ramp       v rises linearly from 0 to V in T_r, then stays                                (6)

rad, rad/s, rad/s^2, s. All are closed forms of t, so that a skipped cycle or a replay changes
nothing.
"""

from typing import Any

from pcpc.executive.laws.block import Block, Port, inline, stage
from pcpc.executive.laws.emath import floor, sincos, where

OUTPUTS = (
    Port("q_d_rad", "rad", "desired angle"),
    Port("q_d_rate_rad_s", "rad/s", "its first derivative"),
    Port("q_d_acc_rad_s2", "rad/s2", "its second derivative"),
)
_AMPLITUDE = Port("amplitude_rad", "rad", "size of the move", None, -4.0, 4.0)
_MOVE = Port("move_s", "s", "duration of the move", None, 1e-3, 1e3)


def _time(name: str, help: str) -> Port:
    return Port(name, "s", help, None, 0.0, 1e6)


@inline
def _rise(s: float) -> Any:
    """Quintic from 0 to 1 for s in 0..1, clamped outside: value, first, second derivative."""
    s = where(s < 0.0, 0.0, where(s > 1.0, 1.0, s))
    s2 = s * s
    value = s2 * s * (10.0 + s * (6.0 * s - 15.0))  # (1)
    first = 30.0 * s2 * (1.0 + s * (s - 2.0))
    second = s * (60.0 + s * (120.0 * s - 180.0))
    return value, first, second


@stage
def quintic_step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Equation (1), up and back."""
    amplitude, move, up, back = p[0], p[1], p[2], p[3]
    u0, u1, u2 = _rise((t - up) / move)
    b0, b1, b2 = _rise((t - back) / move)
    y[0] = amplitude * (u0 - b0)
    y[1] = amplitude * (u1 - b1) / move
    y[2] = amplitude * (u2 - b2) / (move * move)


@stage
def bang_bang_step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Equation (2)."""
    amplitude, move, start = p[0], p[1], p[2]
    s = (t - start) / move
    s = where(s < 0.0, 0.0, where(s > 1.0, 1.0, s))
    left = 1.0 - s
    first_half = s < 0.5
    y[0] = amplitude * where(first_half, 2.0 * s * s, 1.0 - 2.0 * left * left)
    y[1] = amplitude * 4.0 * where(first_half, s, left) / move
    moving = (s > 0.0) & (s < 1.0)
    sign = where(first_half, 1.0, -1.0)
    y[2] = where(moving, sign * 4.0 * amplitude / (move * move), 0.0)


@stage
def step_step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Equation (3)."""
    y[0] = where(t < p[1], 0.0, p[0])
    y[1] = 0.0
    y[2] = 0.0


@stage
def sine_step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Equation (4)."""
    amplitude = p[0]
    omega = 6.283185307179586 * p[1]
    s, c = sincos(omega * t + p[2])
    y[0] = amplitude * s
    y[1] = amplitude * omega * c
    y[2] = -amplitude * omega * omega * s


@stage
def triangle_step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Equation (5): the area under the ramped rate, leg by leg."""
    rate, leg, start, corner = p[0], p[1], p[2], p[3]
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
    y[0] = where(inside, inside_q, outside_q)
    y[1] = where(inside, after * since / corner, where(since < 0.0, -after, after))
    y[2] = where(inside, after / corner, 0.0)
    waiting = t < start
    y[0] = where(waiting, 0.0, y[0])
    y[1] = where(waiting, 0.0, y[1])
    y[2] = where(waiting, 0.0, y[2])


@stage
def ramp_step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Equation (6)."""
    rate, rise = p[0], p[1]
    rising = t < rise
    y[0] = where(rising, 0.5 * rate * t * t / rise, rate * (t - 0.5 * rise))
    y[1] = where(rising, rate * t / rise, rate)
    y[2] = where(rising, rate / rise, 0.0)


quintic = Block(
    quintic_step,
    outputs=OUTPUTS,
    settings=(_AMPLITUDE, _MOVE, _time("up_s", "start up"), _time("back_s", "start back")),
)
bang_bang = Block(
    bang_bang_step, outputs=OUTPUTS, settings=(_AMPLITUDE, _MOVE, _time("start_s", "start"))
)
step = Block(
    step_step, outputs=OUTPUTS, settings=(_AMPLITUDE, _time("start_s", "time of the step"))
)
sine = Block(
    sine_step,
    outputs=OUTPUTS,
    settings=(
        _AMPLITUDE,
        Port("frequency_hz", "Hz", "frequency", None, 0.0, 100.0),
        Port("phase_rad", "rad", "at t = 0", 0.0, -7.0, 7.0),
    ),
)
triangle = Block(
    triangle_step,
    outputs=OUTPUTS,
    settings=(
        Port("rate_rad_s", "rad/s", "slope of the legs", None, 0.0, 10.0),
        _time("leg_s", "duration of a leg"),
        _time("start_s", "rate is zero before"),
        _time("corner_s", "half the time in which the rate turns"),
    ),
)
ramp = Block(
    ramp_step,
    outputs=OUTPUTS,
    settings=(
        Port("rate_rad_s", "rad/s", "final rate", None, -10.0, 10.0),
        _time("rise_s", "rise"),
    ),
)
