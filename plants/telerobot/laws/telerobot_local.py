"""The robot's law that the operator names: `law` comes with u, so that both sides always agree.

    4 network   telerobot_network.py      3 robust   telerobot_robust.py: W rests
    2 As        telerobot_model.py        1 cancel   telerobot_cancel.py
    0 unknown   tau = 0, until the first frame tells; robot_node.py                         (9)

A rig whose operator never changes may name one of the four as its law instead.
rad, rad/s, N m. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 8.
"""

from pcpc.executive.laws.block import Block, inline, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.telerobot.laws import (
    robot_node,
    telerobot_cancel,
    telerobot_model,
    telerobot_network,
)
from pcpc.plants.telerobot.laws.robot_node import (
    CANCEL,
    MODEL,
    ROBUST,
    Inputs,
    Outputs,
    Parameters,
    States,
)


@inline
def chosen(law: float, network: float, model: float, cancel: float) -> float:
    """Return the torque of the law that is in charge."""
    return where(law > MODEL, network, where(law > CANCEL, model, cancel))


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One tick; see the module header."""
    now = robot_node.receive(t, dt, abs(u.law - CANCEL) < 0.5, p, x, u)
    y.norm_w = telerobot_network.hidden(p, x, u)
    network_1, network_2 = telerobot_network.torque(y.norm_w, p, x, u)
    model_1, model_2 = telerobot_model.torque(p, x, u)
    cancel_1, cancel_2 = telerobot_cancel.torque(p, x, u)
    tau_1 = chosen(u.law, network_1, model_1, cancel_1)
    tau_2 = chosen(u.law, network_2, model_2, cancel_2)
    robot_node.send(now, tau_1, tau_2, p, x, u, y)
    telerobot_network.tune(where(u.law > ROBUST, dt * p.gam, 0.0), p, x)


BLOCK = Block(step, settings=robot_node.Settings, prepare=robot_node.prepare)
