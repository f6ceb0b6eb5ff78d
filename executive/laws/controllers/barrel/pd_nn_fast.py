"""The composite law: PD, neural network for the slow part, boundary-layer loop for the fast part.

    e = q_d - (encoder + hull_pitch),  e' = q_d' - hub_rate,  r = e' + Lam e             (1)
    tau   = sat(Kv r + y_NN + Kz (|Z| + Z_B) r + u_F, tau_max)                           (2)
            y_NN, |Z|: tracking_network.py (1)-(6);  u_F: boundary_layer.py (1)-(7)
    u     = sat(tau - Km (w_m/N - w), tau_max),  w = hub_rate - hull_rate                (3)
    motor = u/N                                                                          (4)

rad, rad/s, N m; positive torque raises q. Source: singular-perturbation composite control with a
neural slow part after Lewis, Campos, Selmic (SIAM 2002), chapters 3 and 9; numbers chosen.
"""

from pcpc.executive.laws.block import Block, Ports, group, port, stage
from pcpc.executive.laws.controllers.barrel import boundary_layer, pd, tracking_network


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


class Inputs(pd.Inputs, boundary_layer.Inputs):
    """What all take."""


class Outputs(pd.Outputs, tracking_network.Outputs):
    """Those of PD and network, and the fast loop's torque."""

    fast_Nm = port("N m", "torque of the boundary-layer loop, u_F")


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)  # (1)
    learned = tracking_network.learned_torque(dt, y.e_rad, y.r_rad_s, p.network, x.network, u, y)
    y.fast_Nm = boundary_layer.fast(dt, p.fast, x.fast, u)
    y.tau_Nm = pd.limited(p.pd.kv_Nms_rad * y.r_rad_s + learned + y.fast_Nm, p.pd)  # (2)
    y.motor_torque_Nm = pd.motor_torque(y.tau_Nm, p.pd, u)  # (3) (4)


BLOCK = Block(step, settings=Settings, prepare=tracking_network.prepare)
