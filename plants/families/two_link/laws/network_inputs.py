"""What the networks of the arm's laws see: error, its rate and the reference of both joints.

    x = [1, e1, e2, e1', e2', q_d1, q_d2, q_d1', q_d2', q_d1'', q_d2'']                      (1)

Weights rest in a cycle without new measurements. rad, rad/s. Source: Lewis, Campos, Selmic (SIAM
2002), chapters 3 and 7.
"""

from pcpc.executive.laws.block import Ports, inline, port
from pcpc.executive.laws.emath import where
from pcpc.plants.families.two_link.laws import arm_pd
from pcpc.plants.families.two_link.laws.arm_pd import JOINTS


class Vector(Ports):
    """The vector x (1), in its order."""

    one = port("", "1, for the thresholds")
    e_rad = port("rad", "error", shape=JOINTS)
    e_rate_rad_s = port("rad/s", "its rate", shape=JOINTS)
    q_d_rad = port("rad", "desired angle", shape=JOINTS)
    q_d_rate_rad_s = port("rad/s", "its rate", shape=JOINTS)
    q_d_acc_rad_s2 = port("rad/s2", "its acceleration", shape=JOINTS)


class Inputs(arm_pd.Inputs):
    """Those of the PD law, the rest of the reference, and how old the measurement is."""

    q_d_acc_rad_s2 = port(
        "rad/s2", "desired acceleration of joint #", shape=2, named="q_d_acc_#_rad_s2"
    )
    missing_cycles = port("", "cycles since the last measurement; 0 if it is new")


@inline
def observe(u: Inputs, x: Vector) -> None:
    """Write x (1)."""
    x.one = 1.0
    for i in range(JOINTS):
        x.e_rad[i] = u.q_d_rad[i] - u.q_rad[i]
        x.e_rate_rad_s[i] = u.q_d_rate_rad_s[i] - u.rate_rad_s[i]
        x.q_d_rad[i] = u.q_d_rad[i]
        x.q_d_rate_rad_s[i] = u.q_d_rate_rad_s[i]
        x.q_d_acc_rad_s2[i] = u.q_d_acc_rad_s2[i]


@inline
def tuned_s(dt: float, u: Inputs) -> float:
    """Return for how long to tune in this cycle, s."""
    return where(u.missing_cycles > 0.0, 0.0, dt)
