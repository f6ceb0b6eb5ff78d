"""PD of `pd.py` with an integral of the filtered error; equations (1) (2) (3) (5) (6) are the same.

    s    += T Ki r      while |Kv r + s| < tau_max and |r| < r_max   (else frozen)      (7)
    tau   = sat(Kv r + s, tau_max)                                                      (4')

(4') uses s from before (7). Not in the book: a neural network with a bias node acts largely as an
integrator, and PD alone would be too easy to beat. rad, rad/s, N m; positive torque raises q.
"""

from typing import Any

from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.controllers.barrel import pd
from pcpc.executive.laws.emath import clip, where

GAINS = (
    *pd.GAINS,
    Port("ki_Nm_rad", "N m/rad", "integral gain", None, 0.0, 1.0e5),
    Port("r_max_rad_s", "rad/s", "no integration beyond this filtered error", None, 0.0, 10.0),
)
STATES = (Port("s_Nm", "N m", "integral of the filtered error (7)"),)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    kv, lam, km, gear, tau_max, ki, r_max = p[0], p[1], p[2], p[3], p[4], p[5], p[6]
    q_d, q_d_rate = u[0], u[1]
    encoder, hull_pitch, hub_rate, hull_rate, motor_speed = u[2], u[3], u[4], u[5], u[6]

    e = q_d - (encoder + hull_pitch)  # (1)
    r = (q_d_rate - hub_rate) + lam * e  # (2) (3)
    unlimited = kv * r + x[0]
    tau = clip(unlimited, -tau_max, tau_max)  # (4')
    free = (abs(unlimited) < tau_max) & (abs(r) < r_max)
    x[0] = x[0] + where(free, dt * ki * r, 0.0)  # (7)
    twist_rate = motor_speed / gear - (hub_rate - hull_rate)
    y[0] = clip(tau - km * twist_rate, -tau_max, tau_max) / gear  # (5) (6)
    y[1] = tau
    y[2] = e
    y[3] = r


BLOCK = Block(step, inputs=pd.INPUTS, outputs=pd.OUTPUTS, settings=GAINS, states=STATES)
