"""PD of `pd.py` with the boundary-layer loop of `boundary_layer.py` against the first mode.

    w = Kv r + u_F              u_F: boundary_layer.py (1) to (7); the rest as in pd.py      (1)

rad, rad/s, N m; positive torque raises q.
"""

from pcpc.executive.laws.block import Block, Ports, group, port, stage
from pcpc.plants.atb1000.laws import boundary_layer, pd


class Gains(Ports):
    """Of PD and of the fast loop."""

    pd = group(pd.Gains)
    fast = group(boundary_layer.Parameters)


class Outputs(pd.Outputs):
    """Those of PD, and the fast loop's torque."""

    fast_Nm = port("N m", "torque of the boundary-layer loop, u_F")


@stage
def step(
    t: float, dt: float, p: Gains, x: boundary_layer.States, u: pd.FlexibleInputs, y: Outputs
) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)
    y.fast_Nm = boundary_layer.fast(dt, p.fast, x, u)
    pd.command(p.pd.kv_Nms_rad * y.r_rad_s + y.fast_Nm, p.pd, u, y)  # (1)


BLOCK = Block(step)
