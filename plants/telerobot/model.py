"""The telerobot's arm as one block: two links, friction, a payload that comes and goes.

    M(q) q'' + Vm(q, q') q' + G(q) + Fr = tau                    families/two_link           (1)
    Fr_i = fv q_i' + fc tanh(q_i'/0.05)                                                      (2)
    m2 = load_kg for load_from <= t < load_to, else m2_kg; it changes at samples             (3)
    q'' = M^-1 (tau - Vm q' - G - Fr), classic Runge-Kutta, fixed step                       (4)

    call k of `step` at t = k T:  k = 0  samples of the initial state
                                  k > 0  integrates [t - T, t] in `substeps` steps under the
                                         torque computed from the sample of t - T
                                         (`delay_samples` older ones), then samples

Samples and delay: plants/families/two_link/arm.py. rad, rad/s, N m, s; angles from the horizontal,
q2 relative to link 1; positive torque raises q. Source: Lewis, Campos, Selmic (SIAM 2002), chapters
7 and 8.
"""

from collections.abc import Mapping

from pcpc.executive.laws.block import Block, Prepared, inline, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.families.two_link import arm as two_link_arm
from pcpc.plants.families.two_link.arm import Inputs, Interface, Motion, States
from pcpc.plants.families.two_link.equations import Links

STICTION_RAD_S = 0.05


class Arm(Links):
    """Links, friction, masses, the payload and the integration."""

    gravity_m_s2 = port("m/s2", "g", None, -100.0, 100.0)
    viscous_Nms_rad = port("N m s/rad", "fv of both joints", None, 0.0, 1e4)
    coulomb_Nm = port("N m", "fc of both joints", None, 0.0, 1e4)
    load_kg = port("kg", "m2 while the payload is on", None, 1e-3, 1e4)
    load_from_s = port("s", "payload on", 0.0, 0.0, 1e6)
    load_to_s = port("s", "payload off; not after load_from_s: never on", 0.0, 0.0, 1e6)
    substeps = port("", "integration steps a period, whole", None, 1.0, 1000.0)


class Parameters(Arm, Interface):
    """The arm, and what is between it and the law."""


class Settings(Parameters):
    """The parameters, and the start."""

    start_rad = port(
        "rad", "q# at the start, at rest", None, -10.0, 10.0, shape=2, named="start_#_rad"
    )


class Outputs(two_link_arm.Outputs):
    """Samples, truths and the mass."""

    mass_kg = port("kg", "m2 up to this sample")


@inline
def slope(t: float, p: Parameters, y: Outputs, x: Motion, d: Motion) -> None:
    """Write q' and q'' (4) under the torques and the mass in `y`."""
    two_link_arm.rates(p, y.mass_kg, STICTION_RAD_S, y.acting_Nm, x, d)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance to t, sample; see the module header."""
    middle = t - 0.5 * dt  # of the period: clear of the rounding of its ends
    loaded = (middle >= p.load_from_s) & (middle < p.load_to_s)
    y.mass_kg = where(loaded, p.load_kg, p.m2_kg)  # (3)
    if t > 0.0:
        two_link_arm.receive(p, x.held, u, y)
        two_link_arm.advance(slope, t, dt, p, x, y)
    two_link_arm.sample(p, x.motion.q_rad, x.motion.rate_rad_s, y)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and the arm at rest at its start."""
    own = {one.name: settings[one.name] for one in Parameters.ports}
    states = {"x_q_1_rad": settings["start_1_rad"], "x_q_2_rad": settings["start_2_rad"]}
    return Prepared(own, states)


BLOCK = Block(step, settings=Settings, prepare=prepare)
