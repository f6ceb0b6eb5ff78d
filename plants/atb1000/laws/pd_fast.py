"""PD of `pd.py` with the boundary-layer loop of `boundary_layer.py` against the first mode.

Equations (1) (2) (3) (5) (6) of `pd.py` are the same.

    tau   = sat(Kv r + u_F, tau_max)          u_F: boundary_layer.py (1) to (7)         (4')

rad, rad/s, N m; positive torque raises q.
"""

from pcpc.executive.laws.block import Block, Ports, group, port, stage
from pcpc.plants.atb1000.laws import boundary_layer, pd


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
    pd.errors(p.pd, u, y)  # (1) to (3)
    y.fast_Nm = boundary_layer.fast(dt, p.fast, x, u)
    y.tau_Nm = pd.limited(p.pd.kv_Nms_rad * y.r_rad_s + y.fast_Nm, p.pd)  # (4')
    y.motor_torque_Nm = pd.motor_torque(y.tau_Nm, p.pd, u)  # (5) (6)


BLOCK = Block(step)
