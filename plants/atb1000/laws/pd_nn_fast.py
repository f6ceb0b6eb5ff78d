"""The composite law: PD, neural network for the slow part, boundary-layer loop for the fast part.

    w = Kv r + y_NN + Kz (|Z| + Z_B) r + u_F                              the rest as in pd.py  (1)
            y_NN, |Z|: tracking_network.py (1)-(6);  u_F: boundary_layer.py (1)-(7)

rad, rad/s, N m; positive torque raises q. Source: singular-perturbation composite control with a
neural slow part after Lewis, Campos, Selmic (SIAM 2002), chapters 3 and 9; numbers chosen.
"""

from pcpc.executive.laws.block import Block, Ports, group, port, stage
from pcpc.plants.atb1000.laws import boundary_layer, pd, tracking_network


class Parameters(Ports):
    """Of PD, of the network and of the fast loop."""

    pd = group(pd.Gains)
    network = group(tracking_network.Parameters)
    fast = group(boundary_layer.Parameters)


class Settings(Ports):
    """What a rig gives for them."""

    pd = group(pd.Gains)
    network = group(tracking_network.Settings)
    fast = group(boundary_layer.Parameters)


class States(Ports):
    """Of the network and of the fast loop."""

    network = group(tracking_network.States)
    fast = group(boundary_layer.States)


class Outputs(pd.Outputs, tracking_network.Outputs):
    """Those of PD and network, and the fast loop's torque."""

    fast_Nm = port("N m", "torque of the boundary-layer loop, u_F")


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: pd.FlexibleInputs, y: Outputs) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)
    learned = tracking_network.learned_torque(dt, y.e_rad, y.r_rad_s, p.network, x.network, u, y)
    y.fast_Nm = boundary_layer.fast(dt, p.fast, x.fast, u)
    pd.command(p.pd.kv_Nms_rad * y.r_rad_s + learned + y.fast_Nm, p.pd, u, y)  # (1)


BLOCK = Block(step, settings=Settings, prepare=tracking_network.prepare)
