"""PD of `pd.py` with the torque that the nominal barrel needs along the reference.

    v    = q_d' - hull rate                            desired speed against the hull       (1)
    a_h  = (hull rate - l)/T_h,  l += T a_h            acceleration of the hull, smoothed   (2)
    s    = tanh(v/v_0)                                 direction, smooth at zero            (3)
    f    = k_f [(Fc + (Fs - Fc) exp(-(v/v_s)^2)) s + b v]      trunnion, Stribeck curve     (4)
    T_h  = J_h q_d'' + U cos q_d + f                   what the hub takes from the shaft    (5)
    T_m  = J_m (q_d'' - a_h) + k_f [(Fm + mu |T_h|) s + b_m v]     what the motor keeps     (6)
    w    = Kv r + T_h + T_m                            r and the rest as in pd.py           (7)

Reads what PD reads, and q_d''. Knows the nominal inertias, unbalance and friction; all of (4) to
(6) is on the desired motion, so that it cannot make the loop unstable. k_f < 1 compensates friction
in part: more than there is drives the hub past its target. The rotor turns against the hull, hence
a_h; the part a_h J_m/N of its own turning is left out. rad, rad/s, N m at the output; positive
torque raises q. Source: Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models, analysis
tools and compensation methods for the control of machines with friction, Automatica 30 (1994),
1083-1138; friction curve as in their section 2.
"""

from pcpc.executive.laws.block import Block, Ports, group, inline, port, stage
from pcpc.executive.laws.emath import cos, expmsq, tanh, where
from pcpc.plants.atb1000.laws import pd


class Model(Ports):
    """The nominal barrel, at the output."""

    hub_inertia_kg_m2 = port("kg m^2", "hub and straight barrel, J_h", None, 0.0, 1e6)
    rotor_inertia_kg_m2 = port("kg m^2", "rotor at the output, J_m", None, 0.0, 1e6)
    unbalance_Nm = port("N m", "moment of the weight at 0 deg, U", None, -1e4, 1e4)
    coulomb_Nm = port("N m", "Coulomb friction of the trunnion, Fc", None, 0.0, 1e4)
    breakaway_Nm = port("N m", "its breakaway friction, Fs", None, 0.0, 1e4)
    stribeck_rad_s = port("rad/s", "its Stribeck speed, v_s", None, 1e-6, 1e3)
    viscous_Nms_rad = port("N m s/rad", "its viscous friction, b", None, 0.0, 1e6)
    motor_coulomb_Nm = port("N m", "Coulomb friction of the motor, Fm", None, 0.0, 1e4)
    motor_viscous_Nms_rad = port("N m s/rad", "its viscous friction, b_m", None, 0.0, 1e6)
    mesh_loss = port("", "friction of the teeth per shaft torque, mu", None, 0.0, 1.0)


class Feed(Ports):
    """How much of it is fed forward."""

    friction_share = port("", "k_f, share of the friction that is compensated", None, 0.0, 2.0)
    reverse_rad_s = port("rad/s", "v_0, speed over which friction reverses", None, 1e-5, 10.0)
    hull_lag_s = port("s", "T_h, smoothing of the hull's acceleration", None, 2e-3, 10.0)


class Parameters(Ports):
    """Of PD, the model and the feedforward."""

    pd = group(pd.Gains)
    model = group(Model)
    feed = group(Feed)


class States(Ports):
    """The smoothed hull rate."""

    smooth_rad_s = port("rad/s", "smoothed hull rate, l")
    begun = port("", "1 after the first period")


class Outputs(pd.Outputs):
    """Those of PD, and the parts of the feedforward."""

    friction_Nm = port("N m", "friction fed forward: f and that of the motor")
    fed_Nm = port("N m", "all that is fed forward, T_h + T_m")


@inline
def trunnion(v: float, s: float, p: Model) -> float:
    """Return the Stribeck curve in brackets of (4)."""
    sliding = p.coulomb_Nm + (p.breakaway_Nm - p.coulomb_Nm) * expmsq(v / p.stribeck_rad_s)
    return sliding * s + p.viscous_Nms_rad * v


@inline
def hull_acceleration(dt: float, lag_s: float, x: States, hull_rate: float) -> float:
    """Return a_h and smooth the hull rate (2)."""
    x.smooth_rad_s = where(x.begun > 0.5, x.smooth_rad_s, hull_rate)
    x.begun = 1.0
    acceleration = (hull_rate - x.smooth_rad_s) / lag_s
    x.smooth_rad_s += dt * acceleration
    return acceleration


@inline
def feedforward(a_h: float, p: Parameters, u: pd.TrackingInputs, y: Outputs) -> float:
    """Return T_h + T_m of (5) (6)."""
    m = p.model
    v = u.q_d_rate_rad_s - u.hull_rate_rad_s  # (1)
    s = tanh(v / p.feed.reverse_rad_s)  # (3)
    f = p.feed.friction_share * trunnion(v, s, m)  # (4)
    hub = m.hub_inertia_kg_m2 * u.q_d_acc_rad_s2 + m.unbalance_Nm * cos(u.q_d_rad) + f  # (5)
    lost = (m.motor_coulomb_Nm + m.mesh_loss * abs(hub)) * s + m.motor_viscous_Nms_rad * v
    y.friction_Nm = f + p.feed.friction_share * lost
    inertia = m.rotor_inertia_kg_m2 * (u.q_d_acc_rad_s2 - a_h)
    y.fed_Nm = hub + inertia + p.feed.friction_share * lost  # (6)
    return y.fed_Nm


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: pd.TrackingInputs, y: Outputs) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)
    a_h = hull_acceleration(dt, p.feed.hull_lag_s, x, u.hull_rate_rad_s)
    fed = feedforward(a_h, p, u, y)
    pd.command(p.pd.kv_Nms_rad * y.r_rad_s + fed, p.pd, u, y)  # (7)


BLOCK = Block(step)
