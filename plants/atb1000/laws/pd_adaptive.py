"""PD of `pd.py` with an adaptive model of inertia, friction and weight: a regressor, no network.

    v    = q_d' - hull rate                  desired speed against the hull                 (1)
    s    = tanh(v/v_0)                       direction, smooth at zero                      (2)
    Y    = [q_d'' + Lam e', s, exp(-(v/v_s)^2) s, v, cos q_d]                               (3)
    a    = [inertia, Coulomb, breakaway less Coulomb, viscous, unbalance], estimates        (4)
    w    = Y a + Kv r                        r, e' and the rest as in pd.py                 (5)
    a   <- clip(a + T G Y clip(r, +-0.3), low, high)     projection on a box                (6)
           only while |e| > 0.1 mrad or the reference accelerates

With J r' = Y a_true - tau, a_true in the box, and without the clip and the dead band of (6),
    V = J r^2/2 + (a - a_true)' G^-1 (a - a_true)/2,   V' = -Kv r^2 while nothing is projected,
and V' is no larger where something is. G is diagonal, given per entry. Clip and dead band are those
of the neural laws.

Reads what PD reads, and q_d''. Knows the form of the friction (v_0, v_s) and the box, no value in
it: all estimates begin at 0, or at the box's nearest point. rad, rad/s, N m at the output; positive
torque raises q. Source: Slotine, Li, Applied Nonlinear Control (1991), sections 8.5 and 9.2;
projection: Ioannou, Sun, Robust Adaptive Control (1996), section 4.4.
"""

from pcpc.executive.laws.block import Block, Ports, group, inline, port, stage
from pcpc.executive.laws.emath import clip, cos, expmsq, tanh, where
from pcpc.plants.atb1000.laws import pd

TERMS = 5
R_MAX_RAD_S, DEAD_BAND_RAD = 0.3, 1e-4


class Regressor(Ports):
    """Form of the friction, rates of adaptation and the box."""

    stribeck_rad_s = port("rad/s", "v_s, Stribeck speed", None, 1e-6, 1e3)
    reverse_rad_s = port("rad/s", "v_0, speed over which friction reverses", None, 1e-5, 10.0)
    inertia_rate = port("", "G of the inertia", None, 0.0, 1e6)
    coulomb_rate = port("", "G of the Coulomb friction", None, 0.0, 1e6)
    breakaway_rate = port("", "G of what breakaway is above it", None, 0.0, 1e6)
    viscous_rate = port("", "G of the viscous friction", None, 0.0, 1e6)
    unbalance_rate = port("", "G of the unbalance", None, 0.0, 1e6)
    inertia_max_kg_m2 = port("kg m^2", "inertia lies in 0..this", None, 0.0, 1e6)
    coulomb_max_Nm = port("N m", "Coulomb friction lies in 0..this", None, 0.0, 1e4)
    breakaway_max_Nm = port("N m", "what breakaway is above it lies in 0..this", None, 0.0, 1e4)
    viscous_max_Nms_rad = port("N m s/rad", "viscous friction lies in 0..this", None, 0.0, 1e6)
    unbalance_max_Nm = port("N m", "unbalance lies in +-this", None, 0.0, 1e4)


class Parameters(Ports):
    """Of PD and of the adaptive model."""

    pd = group(pd.Gains)
    regressor = group(Regressor)


class States(Ports):
    """The estimates."""

    inertia_kg_m2 = port("kg m^2", "estimate of the inertia", adapts=True)
    coulomb_Nm = port("N m", "estimate of the Coulomb friction", adapts=True)
    breakaway_Nm = port("N m", "estimate of what breakaway is above it", adapts=True)
    viscous_Nms_rad = port("N m s/rad", "estimate of the viscous friction", adapts=True)
    unbalance_Nm = port("N m", "estimate of the unbalance", adapts=True)
    y = port("", "Y (3) of this period", shape=TERMS, recorded=False)


class Outputs(pd.Outputs):
    """Those of PD, and the adaptive model's torque."""

    modelled_Nm = port("N m", "Y a")


@inline
def adapt(gain: float, p: Regressor, x: States) -> None:
    """Step (6); `gain` = T clip(r), 0 in the dead band; Y of (3) is x.y."""
    inertia = x.inertia_kg_m2 + gain * p.inertia_rate * x.y[0]
    coulomb = x.coulomb_Nm + gain * p.coulomb_rate * x.y[1]
    breakaway = x.breakaway_Nm + gain * p.breakaway_rate * x.y[2]
    viscous = x.viscous_Nms_rad + gain * p.viscous_rate * x.y[3]
    unbalance = x.unbalance_Nm + gain * p.unbalance_rate * x.y[4]
    x.inertia_kg_m2 = clip(inertia, 0.0, p.inertia_max_kg_m2)
    x.coulomb_Nm = clip(coulomb, 0.0, p.coulomb_max_Nm)
    x.breakaway_Nm = clip(breakaway, 0.0, p.breakaway_max_Nm)
    x.viscous_Nms_rad = clip(viscous, 0.0, p.viscous_max_Nms_rad)
    x.unbalance_Nm = clip(unbalance, -p.unbalance_max_Nm, p.unbalance_max_Nm)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: pd.TrackingInputs, y: Outputs) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)
    g = p.regressor
    v = u.q_d_rate_rad_s - u.hull_rate_rad_s  # (1)
    side = tanh(v / g.reverse_rad_s)  # (2)
    x.y[0] = u.q_d_acc_rad_s2 + p.pd.lam_per_s * (u.q_d_rate_rad_s - u.hub_rate_rad_s)  # (3)
    x.y[1], x.y[2], x.y[3] = side, expmsq(v / g.stribeck_rad_s) * side, v
    x.y[4] = cos(u.q_d_rad)
    friction = x.coulomb_Nm * x.y[1] + x.breakaway_Nm * x.y[2] + x.viscous_Nms_rad * x.y[3]
    y.modelled_Nm = x.inertia_kg_m2 * x.y[0] + friction + x.unbalance_Nm * x.y[4]
    pd.command(y.modelled_Nm + p.pd.kv_Nms_rad * y.r_rad_s, p.pd, u, y)  # (5)
    moving = (abs(y.e_rad) > DEAD_BAND_RAD) | (abs(u.q_d_acc_rad_s2) > 1e-6)
    gain = where(moving, dt, 0.0) * clip(y.r_rad_s, -R_MAX_RAD_S, R_MAX_RAD_S)
    adapt(gain, g, x)  # (6)


BLOCK = Block(step)
