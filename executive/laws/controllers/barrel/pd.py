"""Filtered-error PD for one flexible axis behind a gear, with drive-shaft damping.

    e     = q_d - (encoder + hull_pitch)              inertial pointing error           (1)
    e'    = q_d' - hub_rate                                                             (2)
    r     = e' + Lam e                                filtered error                    (3)
    tau   = sat(Kv r, tau_max)                        torque at the output              (4)
    u     = sat(tau - Km (w_m/N - (hub_rate - hull_rate)), tau_max)                     (5)
    motor = u/N                                       what the drive is told            (6)

The bracket in (5) is the twist rate of the drive shaft: zero while the gear is in rigid contact, so
Km damps the drive-train mode and costs no tracking. rad, rad/s, N m; positive torque raises q.
Source: filtered error after Lewis, Campos, Selmic (SIAM 2002), chapter 3; the shaft damping is this
project's.
"""

from typing import Any

from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.emath import clip

INPUTS = (
    Port("q_d_rad", "rad", "desired pointing angle"),
    Port("q_d_rate_rad_s", "rad/s", "its first derivative"),
    Port("encoder_rad", "rad", "hub angle relative to the hull"),
    Port("hull_pitch_rad", "rad", "hull angle, inertial"),
    Port("hub_rate_rad_s", "rad/s", "hub rate gyro, inertial"),
    Port("hull_rate_rad_s", "rad/s", "hull rate gyro, inertial"),
    Port("motor_speed_rad_s", "rad/s", "motor speed relative to the hull"),
)
OUTPUTS = (
    Port("motor_torque_Nm", "N m", "motor torque command (6)"),
    Port("tau_Nm", "N m", "output torque before shaft damping (4)"),
    Port("e_rad", "rad", "pointing error (1)"),
    Port("r_rad_s", "rad/s", "filtered error (3)"),
)
GAINS = (
    Port("kv_Nms_rad", "N m s/rad", "gain on the filtered error", None, 0.0, 1000.0),
    Port("lam_per_s", "1/s", "slope of the filtered error", None, 0.0, 200.0),
    Port("km_Nms_rad", "N m s/rad", "drive-shaft damping", None, 0.0, 1000.0),
    Port("gear_ratio", "", "motor turns per hub turn N", None, 1.0, 1000.0),
    Port("tau_max_Nm", "N m", "limit of the output torque", None, 0.0, 1.0e4),
)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    kv, lam, km, gear, tau_max = p[0], p[1], p[2], p[3], p[4]
    q_d, q_d_rate = u[0], u[1]
    encoder, hull_pitch, hub_rate, hull_rate, motor_speed = u[2], u[3], u[4], u[5], u[6]

    e = q_d - (encoder + hull_pitch)  # (1)
    r = (q_d_rate - hub_rate) + lam * e  # (2) (3)
    tau = clip(kv * r, -tau_max, tau_max)  # (4)
    twist_rate = motor_speed / gear - (hub_rate - hull_rate)
    y[0] = clip(tau - km * twist_rate, -tau_max, tau_max) / gear  # (5) (6)
    y[1] = tau
    y[2] = e
    y[3] = r


BLOCK = Block(step, inputs=INPUTS, outputs=OUTPUTS, settings=GAINS)
