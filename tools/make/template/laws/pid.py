"""PID position control from an encoder alone; its integral does not wind up, and tracks.

    s  += dt/Tt (sent - u')                             0 where this law's u' was sent         (6)
    f  += dt/(Tf + dt) (q - f),   w = (q - f)/Tf        speed: filtered slope of the counts    (1)
    e   = q_d - q                                                                              (2)
    v   = Kp (b q_d - q) - Kd w + s                                                            (3)
    u   = clip(v, +-u_max)                                                                     (4)
    s  += dt Ki e      unless v is beyond u_max and e would drive it further                   (5)

(3) uses s from before (5). In (6) `sent` is what was sent in the cycle before and u' is (4) of it:
where somebody else is in charge, or a hold, s follows what is sent, so that this law takes over
where the other one left. A law without an integral has 1/Tt = 0. With b = 0 a step of q_d goes to
the integral alone: no kick and no overshoot, for poles that are real. The motor without friction is
q'' = (k v - q')/tau with tau = J R/(K K + b R), k = K/(K K + b R); with (1) as fast as (3) is
exact, three poles at -p are

    Kp = 3 p p tau/k,   Ki = p p p tau/k,   Kd = (3 p tau - 1)/k                               (7)

V, rad, rad/s, s; a positive voltage raises q. Source: Astrom, Hagglund, PID Controllers: Theory,
Design, and Tuning (ISA 1995), chapter 3: set-point weight b, derivative filter, windup.
"""

from pcpc.executive.laws.block import Block, Ports, port, stage
from pcpc.executive.laws.emath import clip, where


class Gains(Ports):
    """What `pcpc set controller.ki_V_rads=300` tunes while it runs."""

    kp_V_rad = port("V/rad", "Kp, on the error", None, 0.0, 1e4)
    ki_V_rads = port("V/(rad s)", "Ki, on its integral", None, 0.0, 1e6)
    kd_Vs_rad = port("V s/rad", "Kd, on the speed", None, 0.0, 1e4)
    filter_s = port("s", "Tf, of the speed", None, 1e-4, 10.0)
    weight = port("", "b, share of the reference in the proportional part", None, 0.0, 1.0)
    u_max_V = port("V", "limit of the command", None, 0.0, 1000.0)
    track_per_s = port("1/s", "1/Tt, of the integral that tracks", None, 0.0, 1000.0)


class States(Ports):
    """Of the filter and of the integral."""

    filtered_rad = port("rad", "f (1)")
    integral_V = port("V", "s (5), (6)")
    command_V = port("V", "u'", recorded=False)


class Inputs(Ports):
    """The reference, what the sensor says, and what was sent."""

    q_d_rad = port("rad", "desired angle")
    encoder_rad = port("rad", "measured angle")
    sent_V = port("V", "command of the cycle before, whoever was in charge")


class Outputs(Ports):
    """The command and what led to it."""

    voltage_V = port("V", "command (4)", low=-30.0, high=30.0)
    e_rad = port("rad", "error (2)")
    speed_rad_s = port("rad/s", "speed (1)")


@stage
def step(t: float, dt: float, p: Gains, x: States, u: Inputs, y: Outputs) -> None:
    """One control period."""
    x.integral_V += dt * p.track_per_s * (u.sent_V - x.command_V)  # (6)
    x.filtered_rad += dt / (p.filter_s + dt) * (u.encoder_rad - x.filtered_rad)
    y.speed_rad_s = (u.encoder_rad - x.filtered_rad) / p.filter_s  # (1)
    y.e_rad = u.q_d_rad - u.encoder_rad  # (2)
    proportional_V = p.kp_V_rad * (p.weight * u.q_d_rad - u.encoder_rad)
    wanted_V = proportional_V - p.kd_Vs_rad * y.speed_rad_s + x.integral_V  # (3)
    y.voltage_V = clip(wanted_V, -p.u_max_V, p.u_max_V)  # (4)
    winds_up = (wanted_V - y.voltage_V) * y.e_rad > 0.0
    x.integral_V += where(winds_up, 0.0, dt * p.ki_V_rads * y.e_rad)  # (5)
    x.command_V = y.voltage_V


BLOCK = Block(step)
