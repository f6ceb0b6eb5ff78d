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
    w_m'    = (tau_m - T_fm - T_c - T_s/N)/Jm - phi''                                           (5)
        T_fm = (Tcm + mug |T_s|/N) tanh(w_m/wsm) + bm w_m

    E = (theta', q')M(theta', q')/2 + q'K q/2 + unb sin theta + 9.81 cos theta gamma'q
        + Jm (w_m + phi')^2/2 + ks pen^2/2                                                      (6)

theta is inertial and positive up, th_m and w_m are relative to the hull, rel = theta - phi. T_s is
+ on the hub and -T_s/N on the rotor. No algebraic loop: T_s and T_f depend on states only. (4)
needs no matrix inverse because the modal block of M is 1. (6) is conserved when the hull rests and
friction, damping, drive torque and disturbances are zero; the bristle's own energy is left out.
T_s: gear.py, T_f: friction.py, tau_m: drive.py; T_c is added by rough.py, or 0.
Source: assumed modes on a rotating clamped-free beam, with beam.py's modal data.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.emath import sincos
from pcpc.plants.actuators import drive, friction, gear
from pcpc.plants.atb1000.beam import GRAVITY_M_S2
from pcpc.plants.atb1000.ports import External, Motion, Parameters
from pcpc.plants.sensors import lag_rate


@inline
def gear_state(p: Parameters, s: Motion, w: External) -> tuple[float, float]:
    """Return T_s (N m) and the flank penetration (rad)."""
    wind_up = s.motor_angle_rad / p.gear_ratio - (s.theta_rad - w.pitch_rad)
    wind_up_rate = s.motor_speed_rad_s / p.gear_ratio - (s.theta_rate_rad_s - w.pitch_rate_rad_s)
    pen = gear.penetration(wind_up, p.gap_rad)
    return gear.shaft_torque(pen, wind_up_rate, p.ks_Nm_rad, p.cs_Nms_rad, p.p0_rad), pen


@inline
def trunnion_friction(p: Parameters, s: Motion, w: External) -> tuple[float, float]:
    """Return T_f (N m) and the bristle's rate (rad/s) in the chosen model."""
    v = s.theta_rate_rad_s - w.pitch_rate_rad_s
    torque, bristle_rate = 0.0, 0.0
    if p.friction_model > 0.0:
        scale = 1.0 + w.friction_rise
        g = scale * friction.sliding(v, p.coulomb_Nm, p.breakaway_Nm, p.stribeck_rad_s)
        if p.friction_model > 1.0:
            torque, bristle_rate = friction.lugre(
                v,
                s.bristle_rad,
                g,
                p.sig0_Nm_rad,
                p.sig1_Nms_rad,
                scale * p.sig2_Nms_rad,
                p.bristle_fade_rad_s,
                w.step_s,
            )
        else:
            torque = friction.stribeck(v, g, p.reverse_rad_s, scale * p.sig2_Nms_rad)
    return torque, bristle_rate


@inline
def dot3(m: Array, a: float, b: float, c: float) -> float:
    """Return the product of three numbers of the modes with a vector of them."""
    return m[0] * a + m[1] * b + m[2] * c


@inline
def times_c(p: Parameters, a: float, b: float, c: float) -> tuple[float, float, float]:
    """Return C (a, b, c); C is stored by its upper rows."""
    return (
        dot3(p.centrifugal, a, b, c),
        p.centrifugal[1] * a + p.centrifugal[3] * b + p.centrifugal[4] * c,
        p.centrifugal[2] * a + p.centrifugal[4] * b + p.centrifugal[5] * c,
    )


@inline
def modal_force(i: int, spin: float, weight: float, p: Parameters, s: Motion, w: External) -> float:
    """Return f of mode i (3); `spin` = theta'^2 (C q)_i, `weight` = g cos theta."""
    outside = spin + p.tip[i] * w.muzzle_force_N - p.gravity[i] * weight
    return outside - p.damping_per_s[i] * s.q_rate[i] - p.stiffness_per_s2[i] * s.q[i]


@inline
def barrel_acceleration(p: Parameters, s: Motion, w: External, torque: float, d: Motion) -> None:
    """Write theta'' and q'' of (4) to `d`; `torque` is T_s - T_f."""
    q1, q2, q3 = s.q[0], s.q[1], s.q[2]
    v1, v2, v3 = s.q_rate[0], s.q_rate[1], s.q_rate[2]
    rate = s.theta_rate_rad_s
    sine, cosine = sincos(s.theta_rad)
    g = GRAVITY_M_S2 + w.heave_acc_m_s2
    c1, c2, c3 = times_c(p, q1, q2, q3)
    spin, weight = rate * rate, g * cosine
    f1 = modal_force(0, spin * c1, weight, p, s, w)
    f2 = modal_force(1, spin * c2, weight, p, s, w)
    f3 = modal_force(2, spin * c3, weight, p, s, w)
    m1, m2, m3 = p.coupling[0], p.coupling[1], p.coupling[2]
    coriolis = 2.0 * rate * (v1 * c1 + v2 * c2 + v3 * c3)
    gravity = p.unbalance_Nm * (g / GRAVITY_M_S2) * cosine - g * sine * dot3(p.gravity, q1, q2, q3)
    disturbance = w.hub_moment_Nm + p.length_m * w.muzzle_force_N
    reaction = m1 * f1 + m2 * f2 + m3 * f3
    inertia = p.rigid_inertia_kg_m2 + (q1 * c1 + q2 * c2 + q3 * c3) - (m1 * m1 + m2 * m2 + m3 * m3)
    acceleration = (torque - coriolis - gravity + disturbance - reaction) / inertia
    d.theta_rate_rad_s = acceleration
    d.q_rate[0] = f1 - m1 * acceleration
    d.q_rate[1] = f2 - m2 * acceleration
    d.q_rate[2] = f3 - m3 * acceleration  # (4)


@inline
def rotor_torque(p: Parameters, s: Motion, w: External, gear_torque: float) -> float:
    """Return what turns the rotor in (5) but for T_c, N m."""
    load = gear_torque / p.gear_ratio
    coulomb = p.motor_coulomb_Nm + p.mesh_loss * abs(load)
    loss = friction.coulomb_viscous(
        s.motor_speed_rad_s, coulomb, p.motor_reverse_rad_s, p.motor_viscous_Nms_rad
    )
    return s.motor_torque_Nm - loss - load


@inline
def rotor_acceleration(p: Parameters, s: Motion, w: External, gear_torque: float) -> float:
    """Return w_m' of (5) without T_c."""
    return rotor_torque(p, s, w, gear_torque) / p.motor_inertia_kg_m2 - w.pitch_acc_rad_s2


@inline
def muzzle_rate(p: Parameters, s: Motion) -> float:
    """Return theta' + slope'q'."""
    return s.theta_rate_rad_s + dot3(p.slope, s.q_rate[0], s.q_rate[1], s.q_rate[2])


@inline
def root_strain(p: Parameters, s: Motion) -> float:
    """Return the bending strain at the root in ue."""
    return dot3(p.root_strain_ue, s.q[0], s.q[1], s.q[2])


@inline
def derivative(p: Parameters, s: Motion, w: External, d: Motion) -> None:
    """Write dx/dt to `d` for the motion `s` under `w`: ports.py, Parameters, Motion, External."""
    torque, _ = gear_state(p, s, w)
    opposing, bristle_rate = trunnion_friction(p, s, w)
    d.theta_rad = s.theta_rate_rad_s
    d.q[0], d.q[1], d.q[2] = s.q_rate[0], s.q_rate[1], s.q_rate[2]
    barrel_acceleration(p, s, w, torque - opposing, d)
    d.motor_angle_rad = s.motor_speed_rad_s
    d.motor_speed_rad_s = rotor_acceleration(p, s, w, torque)
    wanted = drive.available_torque(
        w.command_Nm, s.motor_speed_rad_s, p.motor_peak_Nm, p.motor_stall_Nm, p.motor_no_load_rad_s
    )
    d.motor_torque_Nm = drive.torque_rate(s.motor_torque_Nm, wanted, p.motor_lag_s)
    d.bristle_rad = bristle_rate
    d.hub_rate_rad_s = lag_rate(s.hub_rate_rad_s, s.theta_rate_rad_s, p.gyro_bandwidth_hz)
    d.muzzle_rate_rad_s = lag_rate(s.muzzle_rate_rad_s, muzzle_rate(p, s), p.gyro_bandwidth_hz)
    d.strain_ue = lag_rate(s.strain_ue, root_strain(p, s), p.strain_bandwidth_hz)
    d.shaft_torque_Nm = lag_rate(s.shaft_torque_Nm, torque, p.torque_bandwidth_hz)


@inline
def energy(p: Parameters, s: Motion, w: External, pen: float) -> float:
    """Return E of (6) in J."""
    q1, q2, q3 = s.q[0], s.q[1], s.q[2]
    v1, v2, v3 = s.q_rate[0], s.q_rate[1], s.q_rate[2]
    rate, turning = s.theta_rate_rad_s, s.motor_speed_rad_s + w.pitch_rate_rad_s
    sine, cosine = sincos(s.theta_rad)
    c1, c2, c3 = times_c(p, q1, q2, q3)
    inertia = p.rigid_inertia_kg_m2 + (q1 * c1 + q2 * c2 + q3 * c3)
    kinetic = inertia * rate * rate + v1 * v1 + v2 * v2 + v3 * v3
    kinetic += 2.0 * rate * dot3(p.coupling, v1, v2, v3) + p.motor_inertia_kg_m2 * turning * turning
    elastic = dot3(p.stiffness_per_s2, q1 * q1, q2 * q2, q3 * q3) + p.ks_Nm_rad * pen * pen
    weight = p.unbalance_Nm * sine + GRAVITY_M_S2 * cosine * dot3(p.gravity, q1, q2, q3)
    return 0.5 * (kinetic + elastic) + weight
