"""Equations of motion of the barrel plant: hub and three modes, gear, rotor, torque loop, friction.

    x = theta, theta', q(3), q'(3), th_m, w_m, tau_m, z, four sensor lags
    M [theta''; q''] + V + D q' + K q + F + G = B T_s + disturbance                             (1)
    M = [[Mrr0 + q'C q, m'], [m, 1]]
    V_r = 2 theta' q'C q',  V_f = -theta'^2 C q
    G_r = unb (g/9.81) cos theta - g sin theta (gamma'q),  G_f = gamma g cos theta              (2)
        g = 9.81 + heave''
    disturbance: hub moment d_r and muzzle force d_t:  r: d_r + L d_t,  f: tip d_t

    f       = -D q' - K q - G_f + theta'^2 C q + tip d_t                                        (3)
    theta'' = (T_s - T_f - V_r - G_r + d_r + L d_t - m'f)/(Mrr - m'm),  q'' = f - m theta''     (4)
    w_m'    = (tau_m - T_fm - T_s/N)/Jm - phi''                                                 (5)
        T_fm = (Tcm + mug |T_s|/N) tanh(w_m/wsm) + bm w_m

    E = (theta', q')M(theta', q')/2 + q'K q/2 + unb sin theta + 9.81 cos theta gamma'q
        + Jm (w_m + phi')^2/2 + ks pen^2/2                                                      (6)

theta is inertial and positive up, th_m and w_m are relative to the hull, rel = theta - phi. T_s is
+ on the hub and -T_s/N on the rotor. No algebraic loop: T_s and T_f depend on states only. (4)
needs no matrix inverse because the modal block of M is 1. (6) is conserved when the hull rests and
friction, damping, drive torque and disturbances are zero; the bristle's own energy is left out.
T_s: gear.py, T_f: friction.py, tau_m: drive.py.
Source: assumed modes on a rotating clamped-free beam, with beam.py's modal data.
"""

from typing import Any

from pcpc.drivers.jit import compiled, inline
from pcpc.executive.laws.emath import sincos
from pcpc.plants.actuators import drive, friction, gear
from pcpc.plants.atb1000.beam import GRAVITY_M_S2
from pcpc.plants.atb1000.ports import PARAMETERS, STATES, offsets
from pcpc.plants.sensors import lag_rate

_P, _X = offsets(PARAMETERS), offsets(STATES)

RIGID, COUPLING, GRAVITY = _P["rigid_inertia_kg_m2"], _P["coupling"], _P["gravity"]
TIP, SLOPE, STRAIN = _P["tip"], _P["slope"], _P["root_strain_ue"]
STIFFNESS, DAMPING, CENTRIFUGAL = _P["stiffness_per_s2"], _P["damping_per_s"], _P["centrifugal"]
LENGTH, UNBALANCE = _P["length_m"], _P["unbalance_Nm"]
RATIO, GAP, KS, CS, P0 = (
    _P["gear_ratio"], _P["gap_rad"], _P["ks_Nm_rad"], _P["cs_Nms_rad"], _P["p0_rad"],
)  # fmt: skip
ROTOR, MOTOR_LAG, PEAK, STALL, NO_LOAD = (
    _P["motor_inertia_kg_m2"], _P["motor_lag_s"], _P["motor_peak_Nm"], _P["motor_stall_Nm"],
    _P["motor_no_load_rad_s"],
)  # fmt: skip
MOTOR_COULOMB, MOTOR_REVERSE, MOTOR_VISCOUS, MESH_LOSS = (
    _P["motor_coulomb_Nm"], _P["motor_reverse_rad_s"], _P["motor_viscous_Nms_rad"], _P["mesh_loss"],
)  # fmt: skip
FRICTION_MODEL, COULOMB, BREAKAWAY, STRIBECK, REVERSE = (
    _P["friction_model"], _P["coulomb_Nm"], _P["breakaway_Nm"], _P["stribeck_rad_s"],
    _P["reverse_rad_s"],
)  # fmt: skip
SIG0, SIG1, SIG2, FADE = (
    _P["sig0_Nm_rad"], _P["sig1_Nms_rad"], _P["sig2_Nms_rad"], _P["bristle_fade_rad_s"],
)  # fmt: skip
GYRO_HZ, STRAIN_HZ, TORQUE_HZ = (
    _P["gyro_bandwidth_hz"], _P["strain_bandwidth_hz"], _P["torque_bandwidth_hz"],
)  # fmt: skip

THETA, RATE, Q, Q_RATE = _X["x_theta_rad"], _X["x_theta_rate_rad_s"], _X["x_q"], _X["x_q_rate"]
MOTOR_ANGLE, MOTOR_SPEED, MOTOR_TORQUE, BRISTLE = (
    _X["x_motor_angle_rad"], _X["x_motor_speed_rad_s"], _X["x_motor_torque_Nm"],
    _X["x_bristle_rad"],
)  # fmt: skip
HUB_GYRO, MUZZLE_GYRO, ROOT_STRAIN, SHAFT_TORQUE = (
    _X["x_hub_rate_rad_s"], _X["x_muzzle_rate_rad_s"], _X["x_strain_ue"], _X["x_shaft_torque_Nm"],
)  # fmt: skip

# External inputs of the derivative, by position in `w`: hull pitch, rate, acceleration and heave
# acceleration; hub moment d_r and muzzle force d_t; command in force; integration step in s.
PITCH, PITCH_RATE, PITCH_ACC, HEAVE_ACC, HUB_MOMENT, MUZZLE_FORCE, COMMAND, STEP_S = range(8)
EXTERNAL = 8


@inline
def gear_state(p: Any, s: Any, w: Any) -> tuple[float, float]:
    """Return T_s (N m) and the flank penetration (rad)."""
    wind_up = s[MOTOR_ANGLE] / p[RATIO] - (s[THETA] - w[PITCH])
    wind_up_rate = s[MOTOR_SPEED] / p[RATIO] - (s[RATE] - w[PITCH_RATE])
    pen = gear.penetration(wind_up, p[GAP])
    return gear.shaft_torque(pen, wind_up_rate, p[KS], p[CS], p[P0]), pen


@inline
def trunnion_friction(p: Any, s: Any, w: Any) -> tuple[float, float]:
    """Return T_f (N m) and the bristle's rate (rad/s) in the chosen model."""
    v = s[RATE] - w[PITCH_RATE]
    torque, bristle_rate = 0.0, 0.0
    if p[FRICTION_MODEL] > 0.0:
        g = friction.sliding(v, p[COULOMB], p[BREAKAWAY], p[STRIBECK])
        if p[FRICTION_MODEL] > 1.0:
            torque, bristle_rate = friction.lugre(
                v, s[BRISTLE], g, p[SIG0], p[SIG1], p[SIG2], p[FADE], w[STEP_S]
            )
        else:
            torque = friction.stribeck(v, g, p[REVERSE], p[SIG2])
    return torque, bristle_rate


@inline
def dot3(p: Any, at: int, a: float, b: float, c: float) -> float:
    """Return the product of three parameters with a vector of the modes."""
    return p[at] * a + p[at + 1] * b + p[at + 2] * c


@inline
def times_c(p: Any, a: float, b: float, c: float) -> tuple[float, float, float]:
    """Return C (a, b, c); C is stored by its upper rows."""
    return (
        dot3(p, CENTRIFUGAL, a, b, c),
        p[CENTRIFUGAL + 1] * a + p[CENTRIFUGAL + 3] * b + p[CENTRIFUGAL + 4] * c,
        p[CENTRIFUGAL + 2] * a + p[CENTRIFUGAL + 4] * b + p[CENTRIFUGAL + 5] * c,
    )


@inline
def barrel_acceleration(p: Any, s: Any, w: Any, torque: float, d: Any) -> None:
    """Write theta'' and q'' of (4) to `d`; `torque` is T_s - T_f."""
    q1, q2, q3 = s[Q], s[Q + 1], s[Q + 2]
    v1, v2, v3 = s[Q_RATE], s[Q_RATE + 1], s[Q_RATE + 2]
    rate, force = s[RATE], w[MUZZLE_FORCE]
    sine, cosine = sincos(s[THETA])
    g = GRAVITY_M_S2 + w[HEAVE_ACC]
    c1, c2, c3 = times_c(p, q1, q2, q3)
    spin, weight = rate * rate, g * cosine
    f1 = spin * c1 + p[TIP] * force - p[GRAVITY] * weight - p[DAMPING] * v1 - p[STIFFNESS] * q1
    f2 = (
        spin * c2 + p[TIP + 1] * force - p[GRAVITY + 1] * weight
        - p[DAMPING + 1] * v2 - p[STIFFNESS + 1] * q2
    )  # fmt: skip
    f3 = (
        spin * c3 + p[TIP + 2] * force - p[GRAVITY + 2] * weight
        - p[DAMPING + 2] * v3 - p[STIFFNESS + 2] * q3
    )  # fmt: skip  # (3)
    m1, m2, m3 = p[COUPLING], p[COUPLING + 1], p[COUPLING + 2]
    coriolis = 2.0 * rate * (v1 * c1 + v2 * c2 + v3 * c3)
    gravity = p[UNBALANCE] * (g / GRAVITY_M_S2) * cosine - g * sine * dot3(p, GRAVITY, q1, q2, q3)
    disturbance = w[HUB_MOMENT] + p[LENGTH] * force
    reaction = m1 * f1 + m2 * f2 + m3 * f3
    inertia = p[RIGID] + (q1 * c1 + q2 * c2 + q3 * c3) - (m1 * m1 + m2 * m2 + m3 * m3)
    acceleration = (torque - coriolis - gravity + disturbance - reaction) / inertia
    d[RATE] = acceleration
    d[Q_RATE] = f1 - m1 * acceleration
    d[Q_RATE + 1] = f2 - m2 * acceleration
    d[Q_RATE + 2] = f3 - m3 * acceleration  # (4)


@inline
def rotor_acceleration(p: Any, s: Any, w: Any, gear_torque: float) -> float:
    """Return w_m' of (5)."""
    load = gear_torque / p[RATIO]
    coulomb = p[MOTOR_COULOMB] + p[MESH_LOSS] * abs(load)
    loss = friction.coulomb_viscous(s[MOTOR_SPEED], coulomb, p[MOTOR_REVERSE], p[MOTOR_VISCOUS])
    return (s[MOTOR_TORQUE] - loss - load) / p[ROTOR] - w[PITCH_ACC]


@inline
def muzzle_rate(p: Any, s: Any) -> float:
    """Return theta' + slope'q'."""
    return s[RATE] + dot3(p, SLOPE, s[Q_RATE], s[Q_RATE + 1], s[Q_RATE + 2])


@inline
def root_strain(p: Any, s: Any) -> float:
    """Return the bending strain at the root in ue."""
    return dot3(p, STRAIN, s[Q], s[Q + 1], s[Q + 2])


@compiled()
def derivative(p: Any, s: Any, w: Any, d: Any) -> None:
    """Write dx/dt to `d` (16,) for state `s` (16,) and external inputs `w` (8,)."""
    torque, _ = gear_state(p, s, w)
    opposing, bristle_rate = trunnion_friction(p, s, w)
    d[THETA] = s[RATE]
    d[Q], d[Q + 1], d[Q + 2] = s[Q_RATE], s[Q_RATE + 1], s[Q_RATE + 2]
    barrel_acceleration(p, s, w, torque - opposing, d)
    d[MOTOR_ANGLE] = s[MOTOR_SPEED]
    d[MOTOR_SPEED] = rotor_acceleration(p, s, w, torque)
    wanted = drive.available_torque(w[COMMAND], s[MOTOR_SPEED], p[PEAK], p[STALL], p[NO_LOAD])
    d[MOTOR_TORQUE] = drive.torque_rate(s[MOTOR_TORQUE], wanted, p[MOTOR_LAG])
    d[BRISTLE] = bristle_rate
    d[HUB_GYRO] = lag_rate(s[HUB_GYRO], s[RATE], p[GYRO_HZ])
    d[MUZZLE_GYRO] = lag_rate(s[MUZZLE_GYRO], muzzle_rate(p, s), p[GYRO_HZ])
    d[ROOT_STRAIN] = lag_rate(s[ROOT_STRAIN], root_strain(p, s), p[STRAIN_HZ])
    d[SHAFT_TORQUE] = lag_rate(s[SHAFT_TORQUE], torque, p[TORQUE_HZ])


@inline
def energy(p: Any, s: Any, w: Any, pen: float) -> float:
    """Return E of (6) in J."""
    q1, q2, q3 = s[Q], s[Q + 1], s[Q + 2]
    v1, v2, v3 = s[Q_RATE], s[Q_RATE + 1], s[Q_RATE + 2]
    rate, turning = s[RATE], s[MOTOR_SPEED] + w[PITCH_RATE]
    sine, cosine = sincos(s[THETA])
    c1, c2, c3 = times_c(p, q1, q2, q3)
    inertia = p[RIGID] + (q1 * c1 + q2 * c2 + q3 * c3)
    kinetic = inertia * rate * rate + v1 * v1 + v2 * v2 + v3 * v3
    kinetic += 2.0 * rate * dot3(p, COUPLING, v1, v2, v3) + p[ROTOR] * turning * turning
    elastic = dot3(p, STIFFNESS, q1 * q1, q2 * q2, q3 * q3) + p[KS] * pen * pen
    weight = p[UNBALANCE] * sine + GRAVITY_M_S2 * cosine * dot3(p, GRAVITY, q1, q2, q3)
    return 0.5 * (kinetic + elastic) + weight
