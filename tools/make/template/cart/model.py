"""A pole on a cart, with two encoders: force on the cart in, position and angle out.

    a = M + m,   h = m l,   d = J + m l l,   G = m g l,   D = a d - h h              (1)
    a x'' + h q'' cos q = F - b x' + h q' q' sin q      the cart and all on it       (2)
    h x'' cos q + d q'' = G sin q                       the pole about its pivot     (3)
    F   = clip(F_cmd, +-F_max)                          the drive                    (4)
    encoders = D_x floor(x/D_x + 1/2),  D_q floor(q/D_q + 1/2),
               D_q = 2 pi / counts_per_turn                                          (5)

    call k of `step` at t = k dt:  k = 0  the pole leans by start_rad, at rest; sample
                                   k > 0  integrate [t - dt, t] with the force held so far, take
                                          the new one, sample at t

So a command computed from the sample of t_k acts from t_k+1: one sample of delay, as on real
hardware. (2), (3) by Runge-Kutta in `substeps`. Without friction they keep

    E = a x' x'/2 + h x' q' cos q + d q' q'/2 + G cos q,   P = a x' + h q' cos q     (6)

where no force acts: E' = F x', P' = F. Near q = 0 the equations are

    D x'' = d (F - b x') - h G q,   D q'' = a G q - h (F - b x')                     (7)

N, m, m/s, rad, rad/s, s. q is 0 upright and positive towards positive x, l from the pivot to the
pole's centre of mass, J about that. The track has no end, and a pole that falls swings through.
Source: Astrom, Murray, Feedback Systems (Princeton 2008), example 2.1.
"""

from pcpc.executive.laws.block import Block, Ports, group, inline, port, stage
from pcpc.executive.laws.emath import clip, sincos
from pcpc.plants.integrate import runge_kutta, scratch
from pcpc.plants.sensors import rounded

TWO_PI = 6.283185307179586


class Parameters(Ports):
    """Of drive, cart, pole and encoders; rig.yaml says the numbers and where they are from."""

    f_max_N = port("N", "largest force of the drive", None, 0.0, 1e5)
    cart_kg = port("kg", "M, of the cart", None, 1e-3, 1e4)
    pole_kg = port("kg", "m, of the pole", None, 1e-4, 1e4)
    centre_m = port("m", "l, from the pivot to the pole's centre of mass", None, 1e-3, 100.0)
    inertia_kg_m2 = port("kg m^2", "J, of the pole about its centre of mass", None, 0.0, 1e4)
    viscous_Ns_m = port("N s/m", "b, viscous friction of the cart", None, 0.0, 1e4)
    gravity_m_s2 = port("m/s2", "g", 9.81, 0.0, 100.0)
    step_m = port("m", "D_x, step of the cart's encoder; 0: none", None, 0.0, 1.0)
    counts_per_turn = port("", "of the pole's encoder, all four edges", None, 4.0, 1e7)
    start_rad = port("rad", "how far the pole leans at t = 0", 0.0, -7.0, 7.0)
    substeps = port("", "integration steps in a period, a whole number", 1.0, 1.0, 1000.0)


class Motion(Ports):
    """What is integrated."""

    position_m = port("m", "x")
    speed_m_s = port("m/s", "x'")
    angle_rad = port("rad", "q")
    rate_rad_s = port("rad/s", "q'")


class States(Ports):
    """The motion, and the force in force."""

    motion = group(Motion)
    held_N = port("N", "F, until the next call")
    integrator = group(scratch(Motion))


class Inputs(Ports):
    """What came over the bus."""

    force_N = port("N", "newest valid command")


class Outputs(Ports):
    """Two sensors, with their ranges on the bus; the truth is the states, which are recorded."""

    encoder_m = port("m", "position in whole steps (5)", low=-80.0, high=80.0)
    encoder_rad = port("rad", "angle in whole counts (5)", low=-80.0, high=80.0)


@inline
def slope(t: float, p: Parameters, w: States, x: Motion, d: Motion) -> None:
    """Write the derivative of the motion under the force w.held_N: (2), (3), solved."""
    sine, cosine = sincos(x.angle_rad)
    h = p.pole_kg * p.centre_m  # (1)
    both, pole = p.cart_kg + p.pole_kg, p.inertia_kg_m2 + h * p.centre_m
    along = w.held_N - p.viscous_Ns_m * x.speed_m_s + h * x.rate_rad_s * x.rate_rad_s * sine
    about = p.gravity_m_s2 * h * sine
    shared = h * cosine
    determinant = both * pole - shared * shared
    d.position_m = x.speed_m_s
    d.speed_m_s = (pole * along - shared * about) / determinant
    d.angle_rad = x.rate_rad_s
    d.rate_rad_s = (both * about - shared * along) / determinant


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance the pole and the cart from t - dt to t, take the new command, sample."""
    if t > 0.0:
        h = dt / p.substeps
        for _ in range(int(p.substeps)):
            runge_kutta(slope, t, h, p, x, x.motion, x.integrator)
        x.held_N = clip(u.force_N, -p.f_max_N, p.f_max_N)  # (4)
    else:
        x.motion.angle_rad = p.start_rad
    y.encoder_m = rounded(x.motion.position_m, p.step_m)  # (5)
    y.encoder_rad = rounded(x.motion.angle_rad, TWO_PI / p.counts_per_turn)


BLOCK = Block(step)
