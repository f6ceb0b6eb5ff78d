"""Proportional-derivative law for the two-link arm, weighted with the inertia of its model.

    e = q_d - q,   r = e' + Lam e                                                            (1)
    u = Kv r                                             wanted acceleration                 (2)
    tau = Mhat(q) u                                      equations.py, the masses given      (3)

With Mhat = M the filtered error obeys r' = f - Kv r, f = q_d'' + Lam e' + M^-1 (Vm q' + G + Fr):
whatever is not compensated stays as about r = f/Kv. Scalar gains serve both joints. rad, rad/s,
N m; positive torque raises q. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 7.
"""

from pcpc.executive.laws.block import Array, Block, Nothing, Ports, inline, port, stage
from pcpc.executive.laws.emath import cos
from pcpc.plants.families.two_link.equations import inertia, inertia_times
from pcpc.plants.families.two_link.laws import arm_pd
from pcpc.plants.families.two_link.laws.arm_pd import JOINTS, Inputs, Outputs


class Gains(Ports):
    """Gains and the model."""

    kv_per_s = port("1/s", "Kv of both joints", None, 0.0, 1e4)
    lam_per_s = port("1/s", "Lam of both joints", None, 0.0, 1e3)
    a1_m = port("m", "model: length of link 1", None, 1e-3, 100.0)
    a2_m = port("m", "model: length of link 2", None, 1e-3, 100.0)
    m1_kg = port("kg", "model: mass at the end of link 1", None, 1e-3, 1e4)
    m2_kg = port("kg", "model: mass at the end of link 2", None, 1e-3, 1e4)


@inline
def errors(p: Gains, u: Inputs, y: Outputs) -> None:
    """Write e and r (1)."""
    for i in range(JOINTS):
        arm_pd.errors(i, p.lam_per_s, u, y)


@inline
def torques(p: Gains, q: Array, wanted_1: float, wanted_2: float, tau: Array) -> None:
    """Write tau (3) for the wanted accelerations of both joints; `q`: both angles.

    `q`, `tau`: (2,).
    """
    m11, m12, m22 = inertia(cos(q[1]), p.a1_m, p.a2_m, p.m1_kg, p.m2_kg)
    tau[0], tau[1] = inertia_times(m11, m12, m22, wanted_1, wanted_2)


@stage
def step(t: float, dt: float, p: Gains, x: Nothing, u: Inputs, y: Outputs) -> None:
    """One control period; see the module header."""
    errors(p, u, y)
    r = y.r_rad_s
    torques(p, u.q_rad, p.kv_per_s * r[0], p.kv_per_s * r[1], y.torque_Nm)  # (2)


BLOCK = Block(step)
