"""The fast part of a composite controller: damps the first mode of the flexible barrel.

    w_f, h_f      free-hub frequency and gain of mode 1, rotor geared rigidly to the hub     (1)
    eta_m = strain + gravity + inertia   mode 1 against its quasi-static shape, measured     (2)
    inn   = eta_m - x0
    x1   += T (-w_f^2 x0 - 2 z_o w_f x1 + h_f u_F' + L2 inn),  x0 += T (x1 + L1 inn)         (3)
    u_F   = -(k1 x0 + k2 x1)   with the new x0, x1; u_F' is that of the previous period      (4)
    k = -2 (ZD - 0.02) w_f/|h_f|,  k2 = k cos(w_f t_p),  k1 = -k w_f sin(w_f t_p)            (5)
    t_p = 1.5 T + t_a          delay: hold and one sample, current loop, strain filter       (6)
    gate: lp += (T/0.03)(|w| - lp), w hub against hull; u_F *= clip((lp - g)/g, 0, 1),
          g = 1.5 mrad/s: no authority while friction holds the hub                          (7)

k1, k2 follow from T and the tuned values in every period, sine and cosine only when their argument
has changed. Slow and fast part are separated as in singular perturbation, xi = K q/eps^2, with the
slow subsystem's quasi-static deflection as manifold; with Kv/M = 31 rad/s against w_f = 75 rad/s,
eps is not small and the separation is approximate. Modal coordinate in sqrt(kg) m, rad/s, N m.
Source: own design after the boundary-layer method of Lewis, Campos, Selmic (SIAM 2002), chapter 9.
"""

from typing import Any

from pcpc.drivers.jit import inline
from pcpc.executive.laws.block import Port
from pcpc.executive.laws.emath import clip, cos, sincos

INPUTS = (
    Port("q_d_acc_rad_s2", "rad/s2", "desired acceleration"),
    Port("strain_ue", "ue", "bending strain at the barrel root"),
)
PARAMETERS = (
    Port("mode_rad_s", "rad/s", "free-hub frequency of mode 1, w_f", None, 1.0, 1000.0),
    Port("mode_gain", "", "h_f, gain from torque to mode 1", None, -10.0, -1e-3),
    Port("mode_damping", "", "z_o, damping of the observer's model", None, 0.0, 1.0),
    Port("strain_ue_per_mode", "ue", "strain of a unit of mode 1", None, 1.0, 1e9),
    Port("gravity_mode", "", "static deflection of mode 1 at 0 deg, c_g", None, -1.0, 1.0),
    Port("inertia_mode_s2_rad", "s2/rad", "deflection per acceleration, c_a", None, -1.0, 1.0),
    Port("observer_l1_per_s", "1/s", "L1", None, 0.0, 1e5),
    Port("observer_l2_per_s2", "1/s2", "L2", None, 0.0, 1e8),
    Port("damping_wanted", "", "ZD, damping ratio of the closed loop", None, 0.0, 1.0),
    Port("actuator_delay_s", "s", "t_a, current loop and strain filter", None, 0.0, 0.1),
)
STATES = (
    Port("mode_x0", "", "observed departure of mode 1"),
    Port("mode_x1", "", "its rate"),
    Port("fast_held_Nm", "N m", "u_F of the previous period"),
    Port("gate_rad_s", "rad/s", "smoothed speed of the hub against the hull"),
    Port("lead_rad", "rad", "w_f t_p, and its sine and cosine", size=3, recorded=False),
)
(W_F, H_F, Z_O, SCALE, C_G, C_A, L1, L2, ZD, T_A) = range(len(PARAMETERS))
X0, X1, U_F, LP, LEAD = range(len(STATES))
SIZE = LEAD + 3
GATE_LAG_S, GATE_RAD_S = 0.03, 0.0015


@inline
def fast(
    dt: float, q_d: float, q_d_acc: float, strain: float, speed: float, p: Any, x: Any
) -> float:
    """Return u_F; `speed`: hub against hull; `p`, `x` begin with PARAMETERS, STATES."""
    w_f, h_f = p[W_F], p[H_F]
    eta = strain / p[SCALE] + p[C_G] * cos(q_d) + p[C_A] * q_d_acc  # (2)
    innovation = eta - x[X0]
    drive = -w_f * w_f * x[X0] - 2.0 * p[Z_O] * w_f * x[X1] + h_f * x[U_F]
    x[X1] = x[X1] + dt * (drive + p[L2] * innovation)  # (3)
    x[X0] = x[X0] + dt * (x[X1] + p[L1] * innovation)
    k = -2.0 * (p[ZD] - 0.02) * w_f / abs(h_f)  # (5)
    lead = w_f * (1.5 * dt + p[T_A])  # (6)
    if x[LEAD] != lead:
        x[LEAD] = lead
        x[LEAD + 1], x[LEAD + 2] = sincos(lead)
    u = k * w_f * x[LEAD + 1] * x[X0] - k * x[LEAD + 2] * x[X1]  # (4): -(k1 x0 + k2 x1)
    x[LP] = x[LP] + dt / GATE_LAG_S * (abs(speed) - x[LP])  # (7)
    x[U_F] = u * clip((x[LP] - GATE_RAD_S) / GATE_RAD_S, 0.0, 1.0)
    return x[U_F]
