"""The two-link arm that is handed a payload: two torques in, samples and truths out.

    M(q) q'' + Vm(q, q') q' + G(q) + Fr = tau          plants/families/two_link/equations.py     (1)
    Fr_i = fv q_i' + fc tanh(q_i'/w)                         smooth: nothing ever sticks     (2)
    m2   = m2_kg + payload_kg while payload_from <= t < payload_to, else m2_kg               (3)

    call k of `step` at t = k T:  k = 0  samples of the initial state
                                  k > 0  integrates [t - T, t] in `substeps` steps under the torque
                                         computed from the sample of t - T (`delay_samples` older
                                         ones), with the payload of that period, then samples

Classic Runge-Kutta; its local error in the neighbourhood of q' = 0 wants a step well below w M/fc.
The payload comes and goes between two periods, at rest relative to the arm: angles and rates stay
as they were, the momentum jumps. Samples and delay: plants/families/two_link/arm.py. rad, rad/s,
N m, kg, m, s; positive torque raises q. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 7.
"""

from pcpc.executive.laws.block import Block, Ports, inline, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.families.two_link import arm as two_link_arm
from pcpc.plants.families.two_link.arm import Inputs, Interface, Motion, States


class Arm(Ports):
    """Links, friction, masses, the payload and the integration."""

    a1_m = port("m", "length of the first link", None, 1e-3, 100.0)
    a2_m = port("m", "length of the second link", None, 1e-3, 100.0)
    gravity_m_s2 = port("m/s2", "g; 0 for an arm in a horizontal plane", None, -100.0, 100.0)
    viscous_Nms_rad = port("N m s/rad", "fv of both joints", None, 0.0, 1e4)
    coulomb_Nm = port("N m", "fc of both joints", None, 0.0, 1e4)
    smooth_rad_s = port("rad/s", "w, where fc is at 0.76 of its height", None, 1e-3, 10.0)
    m1_kg = port("kg", "point mass at the end of link 1", None, 1e-3, 1e4)
    m2_kg = port("kg", "point mass at the end of link 2, without payload", None, 1e-3, 1e4)
    payload_kg = port("kg", "what is added to m2", 0.0, 0.0, 1e4)
    payload_from_s = port("s", "when it comes", 0.0, 0.0, 1e6)
    payload_to_s = port("s", "when it goes", 0.0, 0.0, 1e6)
    substeps = port("", "Runge-Kutta steps a period, whole", None, 1.0, 1000.0)


class Parameters(Arm, Interface):
    """The arm, and what is between it and the law."""


class Outputs(two_link_arm.Outputs):
    """Samples, truths and the mass."""

    outer_mass_kg = port("kg", "m2 of (3) up to this sample")


@inline
def slope(t: float, p: Parameters, y: Outputs, x: Motion, d: Motion) -> None:
    """Write q' and q'' of (1) (2) under the torques and the mass in `y`."""
    two_link_arm.rates(p, y.outer_mass_kg, p.smooth_rad_s, y.acting_Nm, x, d)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance to t, sample; see the module header."""
    middle = t - 0.5 * dt  # of the period: its ends are rounded
    loaded = (middle >= p.payload_from_s) & (middle < p.payload_to_s)
    y.outer_mass_kg = p.m2_kg + where(loaded, p.payload_kg, 0.0)  # (3)
    if t > 0.0:
        two_link_arm.receive(p, x.held, u, y)
        two_link_arm.advance(slope, t, dt, p, x, y)
    two_link_arm.sample(p, x.motion.q_rad, x.motion.rate_rad_s, y)


BLOCK = Block(step)
