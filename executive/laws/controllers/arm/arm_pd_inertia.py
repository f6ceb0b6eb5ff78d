"""Proportional-derivative law for the two-link arm, weighted with the inertia of its model.

    e = q_d - q,   r = e' + Lam e                                                            (1)
    u = Kv r                                             wanted acceleration                 (2)
    tau = Mhat(q) u                                      two_link.py with the masses given   (3)

With Mhat = M the filtered error obeys r' = f - Kv r, f = q_d'' + Lam e' + M^-1 (Vm q' + G + Fr):
whatever is not compensated stays as about r = f/Kv. Scalar gains serve both joints. rad, rad/s,
N m; positive torque raises q. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 7.
"""

from typing import Any

from pcpc.drivers.jit import inline
from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.controllers.arm import arm_pd
from pcpc.executive.laws.emath import cos
from pcpc.executive.laws.models.two_link import inertia

GAINS = (
    Port("kv_per_s", "1/s", "Kv of both joints", None, 0.0, 1e4),
    Port("lam_per_s", "1/s", "Lam of both joints", None, 0.0, 1e3),
    Port("a1_m", "m", "model: length of link 1", None, 1e-3, 100.0),
    Port("a2_m", "m", "model: length of link 2", None, 1e-3, 100.0),
    Port("m1_kg", "kg", "model: mass at the end of link 1", None, 1e-3, 1e4),
    Port("m2_kg", "kg", "model: mass at the end of link 2", None, 1e-3, 1e4),
)
(KV, LAM, A1, A2, M1, M2) = range(len(GAINS))


@inline
def errors(p: Any, u: Any, y: Any) -> None:
    """Write e and r (1) to y[2..3] and y[4..5]; `u`, `y` as of arm_pd."""
    for i in range(2):
        y[2 + i] = u[i] - u[4 + i]
        y[4 + i] = u[2 + i] - u[6 + i] + p[LAM] * y[2 + i]


@inline
def torques(p: Any, q2: float, u1: float, u2: float, y: Any) -> None:
    """Write tau (3) of the acceleration (u1, u2) to y[0..1]."""
    m11, m12, m22 = inertia(cos(q2), p[A1], p[A2], p[M1], p[M2])
    y[0] = m11 * u1 + m12 * u2
    y[1] = m12 * u1 + m22 * u2


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    errors(p, u, y)
    torques(p, u[5], p[KV] * y[4], p[KV] * y[5], y)  # (2)


BLOCK = Block(step, inputs=arm_pd.INPUTS, outputs=arm_pd.OUTPUTS, settings=GAINS)
