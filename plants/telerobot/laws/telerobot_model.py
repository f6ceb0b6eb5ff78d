"""The robot behaves as a pair of equal poles under u(t - T), as far as its nominal model is right.

    tau = Mhat (ul + A21 q + A22 q') + Vm q' + G                                             (7)

Numbers, ul and limits: robot_node.py. rad, rad/s, N m. Source: Lewis, Campos, Selmic (SIAM 2002),
chapter 8.
"""

from pcpc.executive.laws.block import Block, inline, stage
from pcpc.plants.telerobot.equations import A21, A22
from pcpc.plants.telerobot.laws import robot_node
from pcpc.plants.telerobot.laws.robot_node import Inputs, Outputs, Parameters, States


@inline
def torque(p: Parameters, x: States, u: Inputs) -> tuple[float, float]:
    """Return tau of both joints, before the limits (7)."""
    q, v = u.q_rad, u.rate_rad_s
    a_1 = x.ul[0] + (A21 * q[0] + A22 * v[0])
    a_2 = x.ul[1] + (A21 * q[1] + A22 * v[1])
    return robot_node.computed_torque(a_1, a_2, p, x, u)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One tick; see the module header."""
    now = robot_node.receive(t, dt, False, p, x, u)
    tau_1, tau_2 = torque(p, x, u)  # (7)
    robot_node.send(now, tau_1, tau_2, p, x, u, y)


BLOCK = Block(step, settings=robot_node.Settings, prepare=robot_node.prepare)
