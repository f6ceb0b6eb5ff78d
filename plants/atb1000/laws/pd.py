"""Filtered-error PD for one flexible axis behind a gear, with drive-shaft damping.

    e     = q_d - (encoder + hull_pitch)              inertial pointing error           (1)
    e'    = q_d' - hub_rate                                                             (2)
    r     = e' + Lam e                                filtered error                    (3)
    tau   = sat(w, tau_max),  w = Kv r                torque at the output              (4)
    u     = sat(tau - Km (w_m/N - (hub_rate - hull_rate)), tau_max)                     (5)
    motor = u/N                                       what the drive is told            (6)

The bracket in (5) is the twist rate of the drive shaft: zero while the gear is in rigid contact, so
Km damps the drive-train mode and costs no tracking. Other laws of the barrel want another w; all
else of theirs is (1) to (6). rad, rad/s, N m; positive torque raises q.
Source: filtered error after Lewis, Campos, Selmic (SIAM 2002), chapter 3; the shaft damping is this
project's.
"""

from pcpc.executive.laws.block import Block, Nothing, Ports, inline, port, stage
from pcpc.executive.laws.emath import clip


class Inputs(Ports):
    """The reference and what the sensors say."""

    q_d_rad = port("rad", "desired pointing angle")
    q_d_rate_rad_s = port("rad/s", "its first derivative")
    encoder_rad = port("rad", "hub angle relative to the hull")
    hull_pitch_rad = port("rad", "hull angle, inertial")
    hub_rate_rad_s = port("rad/s", "hub rate gyro, inertial")
    hull_rate_rad_s = port("rad/s", "hull rate gyro, inertial")
    motor_speed_rad_s = port("rad/s", "motor speed relative to the hull")


class TrackingInputs(Inputs):
    """Those, and the acceleration of the reference."""

    q_d_acc_rad_s2 = port("rad/s2", "desired acceleration")


class FlexibleInputs(TrackingInputs):
    """Those, and what bends."""

    strain_ue = port("ue", "bending strain at the barrel root")


class Outputs(Ports):
    """The command and what led to it."""

    motor_torque_Nm = port("N m", "motor torque command (6)")
    tau_Nm = port("N m", "output torque before shaft damping (4)")
    e_rad = port("rad", "pointing error (1)")
    r_rad_s = port("rad/s", "filtered error (3)")


class Gains(Ports):
    """Kv, Lam, Km, N and the limit of the torque."""

    kv_Nms_rad = port("N m s/rad", "gain on the filtered error", None, 0.0, 1000.0)
    lam_per_s = port("1/s", "slope of the filtered error", None, 0.0, 200.0)
    km_Nms_rad = port("N m s/rad", "drive-shaft damping", None, 0.0, 1000.0)
    gear_ratio = port("", "motor turns per hub turn N", None, 1.0, 1000.0)
    tau_max_Nm = port("N m", "limit of the output torque", None, 0.0, 1.0e4)


@inline
def errors(p: Gains, u: Inputs, y: Outputs) -> None:
    """Write e and r: (1) to (3)."""
    y.e_rad = u.q_d_rad - (u.encoder_rad + u.hull_pitch_rad)  # (1)
    y.r_rad_s = (u.q_d_rate_rad_s - u.hub_rate_rad_s) + p.lam_per_s * y.e_rad  # (2) (3)


@inline
def limited(torque: float, p: Gains) -> float:
    """Return the torque within +-tau_max: (4)."""
    return clip(torque, -p.tau_max_Nm, p.tau_max_Nm)


@inline
def motor_torque(tau: float, p: Gains, u: Inputs) -> float:
    """Return what the drive is told: (5) (6)."""
    twist_rate = u.motor_speed_rad_s / p.gear_ratio - (u.hub_rate_rad_s - u.hull_rate_rad_s)
    return limited(tau - p.km_Nms_rad * twist_rate, p) / p.gear_ratio


@inline
def command(wanted: float, p: Gains, u: Inputs, y: Outputs) -> None:
    """Write tau and what the drive is told for the torque that is wanted: (4) to (6)."""
    y.tau_Nm = limited(wanted, p)  # (4)
    y.motor_torque_Nm = motor_torque(y.tau_Nm, p, u)


@stage
def step(t: float, dt: float, p: Gains, x: Nothing, u: Inputs, y: Outputs) -> None:
    """One control period; see the module header."""
    errors(p, u, y)
    command(p.kv_Nms_rad * y.r_rad_s, p, u, y)


BLOCK = Block(step)
