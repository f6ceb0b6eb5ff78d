"""PD of `pd.py` with the boundary-layer loop of `boundary_layer.py` against the first mode.

    e = q_d - (encoder + hull_pitch),  e' = q_d' - hub_rate,  r = e' + Lam e             (1)
    tau   = sat(Kv r + u_F, tau_max)          u_F: boundary_layer.py (1) to (7)          (2)
    u     = sat(tau - Km (w_m/N - w), tau_max),  w = hub_rate - hull_rate                (3)
    motor = u/N                                                                          (4)

rad, rad/s, N m; positive torque raises q.
"""

from pcpc.executive.laws.block import Block, Ports, group, port, stage
from pcpc.executive.laws.controllers.barrel import boundary_layer, pd


class Gains(Ports):
    """Of PD and of the fast loop."""

    pd = group(pd.Gains)
    fast = group(boundary_layer.Parameters)


class Inputs(pd.Inputs, boundary_layer.Inputs):
    """What both take."""


class Outputs(pd.Outputs):
    """Those of PD, and the fast loop's torque."""

    fast_Nm = port("N m", "torque of the boundary-layer loop, u_F")


@stage
def step(t: float, dt: float, p: Gains, x: boundary_layer.States, u: Inputs, y: Outputs) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)  # (1)
    y.fast_Nm = boundary_layer.fast(dt, p.fast, x, u)
    y.tau_Nm = pd.limited(p.pd.kv_Nms_rad * y.r_rad_s + y.fast_Nm, p.pd)  # (2)
    y.motor_torque_Nm = pd.motor_torque(y.tau_Nm, p.pd, u)  # (3) (4)


BLOCK = Block(step)
