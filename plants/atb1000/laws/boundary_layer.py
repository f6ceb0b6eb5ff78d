"""The fast part of a composite controller: damps the first mode of the flexible barrel.

    w_f, h_f      free-hub frequency and gain of mode 1, rotor geared rigidly to the hub     (1)
    eta_m = strain + gravity + inertia   mode 1 against its quasi-static shape, measured     (2)
    inn   = eta_m - x0
    x1   += T (-w_f^2 x0 - 2 z_o w_f x1 + h_f u_F' + L2 inn),  x0 += T (x1 + L1 inn)         (3)
    u_F   = -(k1 x0 + k2 x1)   with the new x0, x1; u_F' is that of the previous period      (4)
    k = -2 (ZD - z_n) w_f/|h_f|,  k2 = k cos(w_f t_p),  k1 = -k w_f sin(w_f t_p)            (5)
    z_n = 0.02                 damping that the mode has by itself
    t_p = 1.5 T + t_a          delay: hold and one sample, current loop, strain filter       (6)
    gate: lp += (T/0.03)(|w| - lp), w hub against hull; u_F *= clip((lp - g)/g, 0, 1),
          g = 1.5 mrad/s: no authority while friction holds the hub                          (7)

k1, k2 follow from T and the tuned values in every period. Slow and fast part are separated as in
singular perturbation, xi = K q/eps^2, with the slow subsystem's quasi-static deflection as
manifold; with Kv/M = 31 rad/s against w_f = 75 rad/s, eps is not small and the separation is
approximate. Modal coordinate in sqrt(kg) m, rad/s, N m.
Source: own design after the boundary-layer method of Lewis, Campos, Selmic (SIAM 2002), chapter 9.
"""

from pcpc.executive.laws.block import Ports, inline, port
from pcpc.executive.laws.emath import clip, cos, sincos
from pcpc.plants.atb1000.laws.pd import FlexibleInputs

NATURAL_DAMPING = 0.02  # z_n
GATE_LAG_S, GATE_RAD_S = 0.03, 0.0015


class Parameters(Ports):
    """The model of mode 1, the observer and the wanted damping."""

    mode_rad_s = port("rad/s", "free-hub frequency of mode 1, w_f", None, 1.0, 1000.0)
    mode_gain = port("", "h_f, gain from torque to mode 1", None, -10.0, -1e-3)
    mode_damping = port("", "z_o, damping of the observer's model", None, 0.0, 1.0)
    strain_ue_per_mode = port("ue", "strain of a unit of mode 1", None, 1.0, 1e9)
    gravity_mode = port("", "static deflection of mode 1 at 0 deg, c_g", None, -1.0, 1.0)
    inertia_mode_s2_rad = port("s2/rad", "deflection per acceleration, c_a", None, -1.0, 1.0)
    observer_l1_per_s = port("1/s", "L1", None, 0.0, 1e5)
    observer_l2_per_s2 = port("1/s2", "L2", None, 0.0, 1e8)
    damping_wanted = port("", "ZD, damping ratio of the closed loop", None, 0.0, 1.0)
    actuator_delay_s = port("s", "t_a, current loop and strain filter", None, 0.0, 0.1)


class States(Ports):
    """The observed mode, the last torque and the gate."""

    mode_x0 = port("", "observed departure of mode 1")
    mode_x1 = port("", "its rate")
    fast_held_Nm = port("N m", "u_F of the previous period")
    gate_rad_s = port("rad/s", "smoothed speed of the hub against the hull")


@inline
def fast(dt: float, p: Parameters, x: States, u: FlexibleInputs) -> float:
    """Return u_F."""
    w_f, h_f = p.mode_rad_s, p.mode_gain
    gravity, inertia = p.gravity_mode * cos(u.q_d_rad), p.inertia_mode_s2_rad * u.q_d_acc_rad_s2
    eta = u.strain_ue / p.strain_ue_per_mode + gravity + inertia  # (2)
    innovation = eta - x.mode_x0
    spring, damper = -w_f * w_f * x.mode_x0, 2.0 * p.mode_damping * w_f * x.mode_x1
    drive = spring - damper + h_f * x.fast_held_Nm
    x.mode_x1 += dt * (drive + p.observer_l2_per_s2 * innovation)  # (3)
    x.mode_x0 += dt * (x.mode_x1 + p.observer_l1_per_s * innovation)
    k = -2.0 * (p.damping_wanted - NATURAL_DAMPING) * w_f / abs(h_f)  # (5)
    s, c = sincos(w_f * (1.5 * dt + p.actuator_delay_s))  # (6)
    u_f = k * w_f * s * x.mode_x0 - k * c * x.mode_x1  # (4): -(k1 x0 + k2 x1)
    speed = u.hub_rate_rad_s - u.hull_rate_rad_s
    x.gate_rad_s += dt / GATE_LAG_S * (abs(speed) - x.gate_rad_s)  # (7)
    x.fast_held_Nm = u_f * clip((x.gate_rad_s - GATE_RAD_S) / GATE_RAD_S, 0.0, 1.0)
    return x.fast_held_Nm
