"""Proportional-derivative law for the two-link arm, with the filtered error.

    e_i = q_d,i - q_i,   e'_i = q_d,i' - q_i'                                                (1)
    r_i = e'_i + Lam_i e_i                                                                   (2)
    tau_i = Kv_i r_i                                                                         (3)

At rest |tau_i| <= |G_i| + friction: what is not compensated stays as e_i = tau_i/(Kv_i Lam_i). rad,
rad/s, N m; positive torque raises q. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 3.
"""

from pcpc.executive.laws.block import Block, Nothing, Ports, inline, port, stage

JOINTS = 2


class Gains(Ports):
    """Kv and Lam of both joints."""

    kv_Nms_rad = port("N m s/rad", "Kv of joint #", None, 0.0, 1e5, shape=2, named="kv_#_Nms_rad")
    lam_per_s = port("1/s", "Lam of joint #", None, 0.0, 1e3, shape=2, named="lam_#_per_s")


class Inputs(Ports):
    """The reference and the measured motion."""

    q_d_rad = port("rad", "desired angle of joint #", shape=2, named="q_d_#_rad")
    q_d_rate_rad_s = port("rad/s", "its rate", shape=2, named="q_d_rate_#_rad_s")
    q_rad = port("rad", "measured angle of joint #", shape=2, named="q_#_rad")
    rate_rad_s = port("rad/s", "measured rate of joint #", shape=2, named="rate_#_rad_s")


class Outputs(Ports):
    """The command and what led to it."""

    torque_Nm = port("N m", "torque of joint #", shape=2, named="torque_#_Nm")
    e_rad = port("rad", "error of joint #, measured", shape=2, named="e_#_rad")
    r_rad_s = port("rad/s", "filtered error of joint #", shape=2, named="r_#_rad_s")


@inline
def errors(i: int, lam: float, u: Inputs, y: Outputs) -> None:
    """Write e and r of joint i: (1) (2)."""
    y.e_rad[i] = u.q_d_rad[i] - u.q_rad[i]
    y.r_rad_s[i] = u.q_d_rate_rad_s[i] - u.rate_rad_s[i] + lam * y.e_rad[i]


@stage
def step(t: float, dt: float, p: Gains, x: Nothing, u: Inputs, y: Outputs) -> None:
    """One control period; see the module header."""
    for i in range(JOINTS):
        errors(i, p.lam_per_s[i], u, y)
        y.torque_Nm[i] = p.kv_Nms_rad[i] * y.r_rad_s[i]  # (3)


BLOCK = Block(step)
