"""Feedback of the full state: it balances the pole, and brings the cart to x_d.

    f  += dt/(Tf + dt) (y - f),   y' = (y - f)/Tf    speeds: filtered slopes of both encoders  (1)
    e   = x_d - x,   e' = x_d' - x'                                                            (2)
    F   = clip(Kq q + Kw q' - Kx e - Kv e', +-F_max)                                           (3)

f begins at the first sample. All gains are positive: the cart runs under the pole where it leans.
A cart that is to go to the right first goes to the left, so that the pole leans to the right. With
(7) of model.py, its a, b, h, d, G and D, and with (1) as fast as (3) is exact, the poles are those
of s^4 + c3 s^3 + c2 s^2 + c1 s + c0 if

    Kx = D c0/G,   Kq = (D c2 + a G + d Kx)/h                                                  (4)
    Kv = b + D c1/G,   Kw = (D c3 + d (Kv - b))/h                                              (5)

Four poles at -p: c3 = 4 p, c2 = 6 p^2, c1 = 4 p^3, c0 = p^4. N, m, m/s, rad, rad/s, s; a positive
force raises x. Source: Astrom, Murray, Feedback Systems (Princeton 2008), chapter 6.
"""

from pcpc.executive.laws.block import Block, Ports, inline, port, stage
from pcpc.executive.laws.emath import clip, where


class Gains(Ports):
    """What `pcpc set controller.kx_N_m=12` tunes while it runs."""

    kx_N_m = port("N/m", "Kx, on the cart's error", None, 0.0, 1e5)
    kv_Ns_m = port("N s/m", "Kv, on its derivative", None, 0.0, 1e5)
    kq_N_rad = port("N/rad", "Kq, on the pole's angle", None, 0.0, 1e5)
    kw_Ns_rad = port("N s/rad", "Kw, on its rate", None, 0.0, 1e5)
    filter_s = port("s", "Tf, of both speeds", None, 1e-4, 10.0)
    f_max_N = port("N", "limit of the command", None, 0.0, 1e5)


class States(Ports):
    """Of the filters."""

    filtered_m = port("m", "f of the position (1)")
    filtered_rad = port("rad", "f of the angle (1)")
    begun = port("", "1 after the first period", recorded=False)


class Inputs(Ports):
    """The reference, and what the sensors say."""

    x_d_m = port("m", "desired position of the cart")
    v_d_m_s = port("m/s", "its derivative")
    encoder_m = port("m", "measured position of the cart")
    encoder_rad = port("rad", "measured angle of the pole")


class Outputs(Ports):
    """The command and what led to it."""

    force_N = port("N", "command (3)", low=-80.0, high=80.0)
    e_m = port("m", "error (2)")
    speed_m_s = port("m/s", "speed of the cart (1)")
    rate_rad_s = port("rad/s", "rate of the pole (1)")


@inline
def follow(filtered: float, sample: float, begun: float, filter_s: float, dt: float) -> float:
    """Return f of (1) after a sample, which it is at the first one."""
    return where(begun > 0.5, filtered + dt / (filter_s + dt) * (sample - filtered), sample)


@stage
def step(t: float, dt: float, p: Gains, x: States, u: Inputs, y: Outputs) -> None:
    """One control period."""
    x.filtered_m = follow(x.filtered_m, u.encoder_m, x.begun, p.filter_s, dt)
    x.filtered_rad = follow(x.filtered_rad, u.encoder_rad, x.begun, p.filter_s, dt)
    x.begun = 1.0
    y.speed_m_s = (u.encoder_m - x.filtered_m) / p.filter_s  # (1)
    y.rate_rad_s = (u.encoder_rad - x.filtered_rad) / p.filter_s
    y.e_m = u.x_d_m - u.encoder_m  # (2)
    balance_N = p.kq_N_rad * u.encoder_rad + p.kw_Ns_rad * y.rate_rad_s
    travel_N = p.kx_N_m * y.e_m + p.kv_Ns_m * (u.v_d_m_s - y.speed_m_s)
    y.force_N = clip(balance_N - travel_N, -p.f_max_N, p.f_max_N)  # (3)


BLOCK = Block(step)
