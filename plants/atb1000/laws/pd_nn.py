"""PD of `pd.py` with the neural network of `tracking_network.py`.

Equations (1) (2) (3) (5) (6) of `pd.py` are the same.

    tau   = sat(Kv r + y_NN + Kz (|Z| + Z_B) r, tau_max)    tracking_network.py (1)-(6) (4')

M r' = -V_m r + f(x) + d - tau with f = M (q_d'' + Lam e') + ... + friction + gravity: the network
learns f along the reference. rad, rad/s, N m; positive torque raises q.
Source: filtered-error neural control after Lewis, Campos, Selmic (SIAM 2002), chapter 3.
"""

from pcpc.executive.laws.block import Block, Ports, group, port, stage
from pcpc.plants.atb1000.laws import pd, tracking_network


class Parameters(Ports):
    """Of PD and of the network."""

    pd = group(pd.Gains)
    network = group(tracking_network.Parameters)


class Settings(Ports):
    """What a rig gives for them."""

    pd = group(pd.Gains)
    network = group(tracking_network.Settings)


class Inputs(pd.Inputs):
    """Those of PD, and the acceleration."""

    q_d_acc_rad_s2 = port("rad/s2", "desired acceleration")


class Outputs(pd.Outputs, tracking_network.Outputs):
    """Those of both."""


@stage
def step(
    t: float, dt: float, p: Parameters, x: tracking_network.States, u: Inputs, y: Outputs
) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)  # (1) to (3)
    learned = tracking_network.learned_torque(dt, y.e_rad, y.r_rad_s, p.network, x, u, y)
    y.tau_Nm = pd.limited(p.pd.kv_Nms_rad * y.r_rad_s + learned, p.pd)  # (4')
    y.motor_torque_Nm = pd.motor_torque(y.tau_Nm, p.pd, u)  # (5) (6)


BLOCK = Block(step, settings=Settings, prepare=tracking_network.prepare)
