"""Proportional-derivative law for the two-link arm, with the filtered error.

    e_i = q_d,i - q_i,   e'_i = q_d,i' - q_i'                                                (1)
    r_i = e'_i + Lam_i e_i                                                                   (2)
    tau_i = Kv_i r_i                                                                         (3)

At rest |tau_i| <= |G_i| + friction: what is not compensated stays as e_i = tau_i/(Kv_i Lam_i). rad,
rad/s, N m; positive torque raises q. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 3.
"""

from typing import Any

from pcpc.executive.laws.block import Block, Port, stage

GAINS = (
    Port("kv_1_Nms_rad", "N m s/rad", "Kv of joint 1", None, 0.0, 1e5),
    Port("kv_2_Nms_rad", "N m s/rad", "Kv of joint 2", None, 0.0, 1e5),
    Port("lam_1_per_s", "1/s", "Lam of joint 1", None, 0.0, 1e3),
    Port("lam_2_per_s", "1/s", "Lam of joint 2", None, 0.0, 1e3),
)
INPUTS = (
    Port("q_d_1_rad", "rad", "desired angle of joint 1"),
    Port("q_d_2_rad", "rad", "desired angle of joint 2"),
    Port("q_d_rate_1_rad_s", "rad/s", "its rate"),
    Port("q_d_rate_2_rad_s", "rad/s", "its rate"),
    Port("q_1_rad", "rad", "measured angle of joint 1"),
    Port("q_2_rad", "rad", "measured angle of joint 2"),
    Port("rate_1_rad_s", "rad/s", "measured rate of joint 1"),
    Port("rate_2_rad_s", "rad/s", "measured rate of joint 2"),
)
OUTPUTS = (
    Port("torque_1_Nm", "N m", "torque of joint 1"),
    Port("torque_2_Nm", "N m", "torque of joint 2"),
    Port("e_1_rad", "rad", "error of joint 1, measured"),
    Port("e_2_rad", "rad", "error of joint 2, measured"),
    Port("r_1_rad_s", "rad/s", "filtered error of joint 1"),
    Port("r_2_rad_s", "rad/s", "filtered error of joint 2"),
)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    for i in range(2):
        e = u[i] - u[4 + i]  # (1)
        r = u[2 + i] - u[6 + i] + p[2 + i] * e  # (2)
        y[i] = p[i] * r  # (3)
        y[2 + i] = e
        y[4 + i] = r


BLOCK = Block(step, inputs=INPUTS, outputs=OUTPUTS, settings=GAINS)
