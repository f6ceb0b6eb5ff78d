"""The two-link arm with friction as one block: two torques in, samples and truths out.

    M(q) q'' + Vm(q, q') q' + G(q) + F = tau                     families/two_link           (1)
    friction_model 0   F = 0
                   1   F = level(|v|) Sgn(v), exponential        sliding.py, stick_slip.py   (2)
                   2   F of LuGre, with viscous a2 v             lugre_implicit.py           (3)
    p = M v + dt (tau - h),  h = Vm v + G at the old q, v;  v+ from (2) or (3);  q+ = q + dt v+
                                                                                             (4)

    call k of `step` at t = k T:  k = 0  samples of the initial state
                                  k > 0  integrates [t - T, t] in whole steps of about `step_s`
                                         under the torque computed from the sample of t - T
                                         (`delay_samples` older ones), then samples

Samples and delay: plants/families/two_link/arm.py. In (3) a2 is truly viscous, N m s/rad; in (2) it
saturates. Without friction and torque the energy is constant as dt goes to 0. rad, rad/s, N m, s;
positive torque raises q.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 3.
"""

from collections.abc import Mapping

from pcpc.executive.laws.block import Array, Block, Ports, Prepared, group, inline, port, stage
from pcpc.plants.actuators import lugre_implicit, sliding, stick_slip
from pcpc.plants.families.two_link import arm as two_link_arm
from pcpc.plants.families.two_link.arm import Held, Inputs, Interface
from pcpc.plants.families.two_link.equations import Links, gravity_torque, motion

SET_VALUED, LUGRE = 1.0, 2.0  # values of friction_model, beside 0


def _friction_of(joint: int) -> type[Ports]:
    """Return the declaration of one joint's friction."""
    i = joint

    class Friction(Ports):
        a0_Nm = port(
            "N m", f"a0 of joint {i}, Coulomb level", None, 0.0, 1e4, named=f"coulomb_{i}_Nm"
        )
        a1_Nm = port(
            "N m", "a1, what stiction adds to it", None, 0.0, 1e4, named=f"stiction_{i}_Nm"
        )
        a2_Nm = port(
            "N m", "a2, saturating; N m s/rad in LuGre", None, 0.0, 1e4, named=f"viscous_{i}_Nm"
        )
        beta1_s_rad = port(
            "s/rad", "B1, decay of stiction", None, 0.0, 1e6, named=f"beta1_{i}_s_rad"
        )
        beta2_s_rad = port(
            "s/rad", "B2, rise of the viscous part", None, 0.0, 1e6, named=f"beta2_{i}_s_rad"
        )

    return Friction


class Arm(Links):
    """Links, masses and friction."""

    gravity_m_s2 = port("m/s2", "g; 0 for an arm in a horizontal plane", None, -100.0, 100.0)
    friction_model = port("", "0 none, 1 exponential set-valued, 2 LuGre", None, 0.0, 2.0)
    joint_1 = group(_friction_of(1))
    joint_2 = group(_friction_of(2))
    s0_Nm_rad = port("N m/rad", "stiffness of the bristles, LuGre", None, 1e-6, 1e9)
    s1_Nms_rad = port("N m s/rad", "damping of the bristles, LuGre", None, 0.0, 1e6)
    v0_rad_s = port("rad/s", "Stribeck speed, LuGre", None, 1e-6, 1e3)


class Shared(Arm, Interface):
    """The arm, and what is between it and the law."""


class Parameters(Shared):
    """These, and the integration."""

    substeps = port("", "integration steps a period")


class Settings(Shared):
    """These, and what is computed at the start."""

    step_s = port("s", "integration step, made to fit a period", None, 1e-7, 1.0)
    start_rad = port(
        "rad", "q# at the start, at rest", 0.0, -10.0, 10.0, shape=2, named="start_#_rad"
    )


class Motion(two_link_arm.Motion):
    """What a step advances."""

    z_rad = port("rad", "bristles of joint #, LuGre", shape=2, named="z_#_rad")
    friction_Nm = port("N m", "F# of the last step", shape=2, named="friction_#_Nm")


class States(Ports):
    """Motion, and torques on their way."""

    motion = group(Motion, "x_")
    held = group(Held, "held_")


class Outputs(two_link_arm.Outputs):
    """Samples, truths and friction."""

    friction_Nm = port(
        "N m", "friction torque F#, opposes the motion", shape=2, named="friction_#_Nm"
    )


@inline
def level(v: float, f: Ports) -> float:
    """Return the friction level (2) of a joint, N m."""
    return sliding.exponential(abs(v), f.a0_Nm, f.a1_Nm, f.a2_Nm, f.beta1_s_rad, f.beta2_s_rad)


@inline
def set_valued(
    p1: float, p2: float, m11: float, m12: float, m22: float, dt: float, p: Parameters, x: Motion
) -> tuple[float, float]:
    """Return v+ of (2); without friction both levels are 0."""
    c1, c2 = 0.0, 0.0
    if p.friction_model == SET_VALUED:
        c1, c2 = dt * level(x.rate_rad_s[0], p.joint_1), dt * level(x.rate_rad_s[1], p.joint_2)
    return stick_slip.velocities(p1, p2, c1, c2, m11, m12, m22)


@inline
def bristle_rate(v: float, p: Parameters, f: Ports) -> float:
    """Return a of lugre_implicit.py for a joint, 1/s."""
    return lugre_implicit.bristle_rate(v, p.s0_Nm_rad, f.a0_Nm, f.a1_Nm, p.v0_rad_s)


@inline
def torque_line(z: float, rate: float, dt: float, p: Parameters, f: Ports) -> tuple[float, float]:
    """Return A and B of lugre_implicit.py for a joint, N m s/rad and N m."""
    return lugre_implicit.torque_line(z, rate, p.s0_Nm_rad, p.s1_Nms_rad, f.a2_Nm, dt)


@inline
def lugre(
    p1: float, p2: float, m11: float, m12: float, m22: float, dt: float, p: Parameters, x: Motion
) -> tuple[float, float]:
    """Return v+ of (3) and advance the bristles."""
    v, z = x.rate_rad_s, x.z_rad
    rate_1, rate_2 = bristle_rate(v[0], p, p.joint_1), bristle_rate(v[1], p, p.joint_2)
    slope_1, offset_1 = torque_line(z[0], rate_1, dt, p, p.joint_1)
    slope_2, offset_2 = torque_line(z[1], rate_2, dt, p, p.joint_2)
    v1, v2 = lugre_implicit.velocities(
        p1 - dt * offset_1, p2 - dt * offset_2, slope_1, slope_2, m11, m12, m22, dt
    )
    z[0] = lugre_implicit.bristle(z[0], v1, rate_1, dt)
    z[1] = lugre_implicit.bristle(z[1], v2, rate_2, dt)
    return v1, v2


@inline
def advance(tau: Array, dt: float, p: Parameters, x: Motion) -> None:
    """One step (4) of positions, rates, bristles and friction torques under constant `tau` (2,)."""
    q, v = x.q_rad, x.rate_rad_s
    m11, m12, m22, c1, c2 = motion(p, p.m2_kg, q, v)
    g1, g2 = gravity_torque(q[0], q[1], p.a1_m, p.a2_m, p.m1_kg, p.m2_kg, p.gravity_m_s2)
    p1 = m11 * v[0] + m12 * v[1] + dt * (tau[0] - c1 - g1)
    p2 = m12 * v[0] + m22 * v[1] + dt * (tau[1] - c2 - g2)
    if p.friction_model == LUGRE:
        v1, v2 = lugre(p1, p2, m11, m12, m22, dt, p, x)
    else:
        v1, v2 = set_valued(p1, p2, m11, m12, m22, dt, p, x)
    x.friction_Nm[0] = (p1 - m11 * v1 - m12 * v2) / dt
    x.friction_Nm[1] = (p2 - m12 * v1 - m22 * v2) / dt
    v[0], v[1] = v1, v2
    for j in range(len(q)):
        q[j] += dt * v[j]


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance to t, sample; see the module header."""
    if t > 0.0:
        two_link_arm.receive(p, x.held, u, y)
        for _ in range(int(p.substeps)):
            advance(y.acting_Nm, dt / p.substeps, p, x.motion)
    two_link_arm.sample(p, x.motion.q_rad, x.motion.rate_rad_s, y)
    for j in range(len(y.friction_Nm)):
        y.friction_Nm[j] = x.motion.friction_Nm[j]


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters, with the steps a period, and the arm at rest at its start."""
    shared = {port.name: settings[port.name] for port in Shared.ports}
    substeps = max(1, round(1.0 / (rate_hz * settings["step_s"])))
    states = {"x_q_1_rad": settings["start_1_rad"], "x_q_2_rad": settings["start_2_rad"]}
    return Prepared({**shared, "substeps": float(substeps)}, states)


BLOCK = Block(step, settings=Settings, prepare=prepare)
