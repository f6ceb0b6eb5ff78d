"""The robot behaves as a pair of equal poles under u(t - T): a network learns what M does not know.

    st  = 10 (q - qh) + 2 (q' - qh')  = B'P (x - xh),  As'P + P As = -diag(500, 500, 20, 20)  (1)
    ph  = tanh(V'[1; q; q'])                           L = 20 nodes, W (20, 2), V (5, 20)     (2)
    v   = (Kr + Kw |W|) st                             robust term                            (3)
    tau = Mhat (ul + A21 q + A22 q' - W'ph - v)        within +-tau_max                       (4)
    xh+ = Ad xh + Bd (ul + Mhat^-1 (tau - tau before the limits))          robot_node.py      (5)
    W  += h Gam (ph st' - kap W)                       after (4), which uses the old W        (6)

(4) puts q'' = As-part + u(t - T) + what Mhat, which knows no gravity, friction or payload, leaves;
W'ph learns that, and xh, the recurrent identifier, is then a reference model. kap > 0 has to be a
constant leak: the delay puts W~(t - T) into r' (Theorem 8.5.1).

ul = u(t - T), limits and start: robot_node.py. rad, rad/s, N m. Source: Lewis, Campos, Selmic (SIAM
2002), chapter 8; numbers are this project's.
"""

from pcpc.executive.laws.block import Block, inline, stage
from pcpc.executive.laws.emath import sqrt, tanh
from pcpc.plants.telerobot.equations import A21, A22, JOINTS
from pcpc.plants.telerobot.laws import robot_node
from pcpc.plants.telerobot.laws.robot_node import (
    NET_INPUTS,
    NODES,
    Inputs,
    Outputs,
    Parameters,
    States,
)


@inline
def hidden(p: Parameters, x: States, u: Inputs) -> float:
    """Write st (1), ph (2) and W'ph; return |W|."""
    x.seen[0] = 1.0
    for j in range(JOINTS):
        q, v = u.q_rad[j], u.rate_rad_s[j]
        x.seen[1 + j], x.seen[1 + JOINTS + j] = q, v
        x.st[j] = 10.0 * (q - x.xh.q[j]) + 2.0 * (v - x.xh.v[j])  # (1)
        x.learned[j] = 0.0
    total = 0.0
    for n in range(NODES):
        a = 0.0
        for i in range(NET_INPUTS):
            a += p.v[i, n] * x.seen[i]
        x.ph[n] = tanh(a)  # (2)
        for j in range(JOINTS):
            x.learned[j] += x.w[n, j] * x.ph[n]
            total += x.w[n, j] * x.w[n, j]
    return sqrt(total)


@inline
def acceleration(j: int, norm_w: float, p: Parameters, x: States, u: Inputs) -> float:
    """Return what Mhat multiplies in (4), for joint `j`."""
    v = (p.kr_per_s + p.kw * norm_w) * x.st[j]  # (3)
    return x.ul[j] + (A21 * u.q_rad[j] + A22 * u.rate_rad_s[j]) - (x.learned[j] + v)  # (4)


@inline
def torque(norm_w: float, p: Parameters, x: States, u: Inputs) -> tuple[float, float]:
    """Return tau of both joints, before the limits."""
    a_1, a_2 = acceleration(0, norm_w, p, x, u), acceleration(1, norm_w, p, x, u)
    return robot_node.inertia_torque(a_1, a_2, x)  # (4)


@inline
def tune(rate: float, p: Parameters, x: States) -> None:
    """Step (6); `rate` is h Gam."""
    for n in range(NODES):
        for j in range(JOINTS):
            x.w[n, j] += rate * (x.ph[n] * x.st[j] - p.kap * x.w[n, j])  # (6)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One tick; see the module header."""
    now = robot_node.receive(t, dt, False, p, x, u)  # ul, xh, Mhat
    y.norm_w = hidden(p, x, u)  # (1) (2)
    tau_1, tau_2 = torque(y.norm_w, p, x, u)  # (3) (4)
    robot_node.send(now, tau_1, tau_2, p, x, u, y)  # (5)
    tune(dt * p.gam, p, x)  # (6)


BLOCK = Block(step, settings=robot_node.Settings, prepare=robot_node.prepare)
