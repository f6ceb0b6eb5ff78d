"""PD of `pd.py` with the neural network of `tracking_network.py`.

    w = Kv r + y_NN + Kz (|Z| + Z_B) r      tracking_network.py (1) to (6); the rest as in pd.py (1)

M r' = -V_m r + f(x) + d - tau with f = M (q_d'' + Lam e') + ... + friction + gravity: the network
learns f along the reference. rad, rad/s, N m; positive torque raises q.
Source: filtered-error neural control after Lewis, Campos, Selmic (SIAM 2002), chapter 3.
"""

from pcpc.executive.laws.block import Block, Ports, group, stage
from pcpc.plants.atb1000.laws import pd, tracking_network


class Parameters(Ports):
    """Of PD and of the network."""

    pd = group(pd.Gains)
    network = group(tracking_network.Parameters)


class Settings(Ports):
    """What a rig gives for them."""

    pd = group(pd.Gains)
    network = group(tracking_network.Settings)


class Outputs(pd.Outputs, tracking_network.Outputs):
    """Those of both."""


@stage
def step(
    t: float,
    dt: float,
    p: Parameters,
    x: tracking_network.States,
    u: pd.TrackingInputs,
    y: Outputs,
) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)
    learned = tracking_network.learned_torque(dt, y.e_rad, y.r_rad_s, p.network, x, u, y)
    pd.command(p.pd.kv_Nms_rad * y.r_rad_s + learned, p.pd, u, y)  # (1)


BLOCK = Block(step, settings=Settings, prepare=tracking_network.prepare)
