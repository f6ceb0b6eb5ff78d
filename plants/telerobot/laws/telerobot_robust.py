"""The law of telerobot_network.py without its tuning (6): W stays 0, the robust term is alone.

    tau = Mhat (ul + A21 q + A22 q' - Kr st)                                             (3) (4)

rad, rad/s, N m. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 8.
"""

from pcpc.executive.laws.block import Block, stage
from pcpc.plants.telerobot.laws import robot_node, telerobot_network
from pcpc.plants.telerobot.laws.robot_node import Inputs, Outputs, Parameters, States


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One tick; see the module header."""
    now = robot_node.receive(t, dt, False, p, x, u)
    y.norm_w = telerobot_network.hidden(p, x, u)  # (1) (2)
    tau_1, tau_2 = telerobot_network.torque(y.norm_w, p, x, u)  # (3) (4)
    robot_node.send(now, tau_1, tau_2, p, x, u, y)  # (5)


BLOCK = Block(step, settings=robot_node.Settings, prepare=robot_node.prepare)
