"""The two-link arm that is handed a payload: two torques in, samples and truths out.

    arm.py (1) (2) with m2 = m2_kg + payload_kg while payload_from <= t < payload_to         (1)

    call k of `step` at t = k T:  k = 0  samples of the initial state
                                  k > 0  integrates [t - T, t] in `substeps` steps under the torque
                                         computed from the sample of t - T (`delay_samples` older
                                         ones), with the payload of that period, then samples

The payload comes and goes between two periods, at rest relative to the arm: angles and rates stay
as they were, the momentum jumps. A sample is rounded to a multiple of its `..._lsb_...`, half up;
so is the torque that acts; 0 does not round. rad, rad/s, N m, kg, s; positive torque raises q.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 7.
"""

from typing import Any

from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.payload_arm import arm
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed

SETTINGS = (
    *arm.PORTS,
    Port("m1_kg", "kg", "point mass at the end of link 1", None, 1e-3, 1e4),
    Port("m2_kg", "kg", "point mass at the end of link 2, without payload", None, 1e-3, 1e4),
    Port("payload_kg", "kg", "what is added to m2", 0.0, 0.0, 1e4),
    Port("payload_from_s", "s", "when it comes", 0.0, 0.0, 1e6),
    Port("payload_to_s", "s", "when it goes", 0.0, 0.0, 1e6),
    Port("substeps", "", "Runge-Kutta steps a period, whole", None, 1.0, 1000.0),
    Port("delay_samples", "", "age of the torque that acts, whole", 0.0, 0.0, DELAY_SIZE - 1.0),
    Port("torque_lsb_Nm", "N m", "quantum of the torque that acts, 0 none", 0.0, 0.0, 1e3),
    Port("position_lsb_rad", "rad", "quantum of the position samples, 0 none", 0.0, 0.0, 1.0),
    Port("rate_lsb_rad_s", "rad/s", "quantum of the rate samples, 0 none", 0.0, 0.0, 10.0),
)
(M1, M2, PAYLOAD, FROM, TO, SUBSTEPS, DELAY, TORQUE_LSB, POSITION_LSB, RATE_LSB) = range(
    len(arm.PORTS), len(SETTINGS)
)
INPUTS = (
    Port("torque_1_Nm", "N m", "newest valid command to joint 1"),
    Port("torque_2_Nm", "N m", "newest valid command to joint 2"),
)
OUTPUTS = (
    Port("sample_1_rad", "rad", "sensor: q1"),
    Port("sample_2_rad", "rad", "sensor: q2"),
    Port("rate_sample_1_rad_s", "rad/s", "sensor: q1'"),
    Port("rate_sample_2_rad_s", "rad/s", "sensor: q2'"),
    Port("q_1_rad", "rad", "true q1"),
    Port("q_2_rad", "rad", "true q2"),
    Port("rate_1_rad_s", "rad/s", "true q1'"),
    Port("rate_2_rad_s", "rad/s", "true q2'"),
    Port("acting_1_Nm", "N m", "torque on joint 1 up to this sample"),
    Port("acting_2_Nm", "N m", "torque on joint 2 up to this sample"),
    Port("outer_mass_kg", "kg", "m2 of (1) up to this sample"),
)
STATES = (
    Port("x_q_1_rad", "rad", "q1"),
    Port("x_q_2_rad", "rad", "q2"),
    Port("x_rate_1_rad_s", "rad/s", "q1'"),
    Port("x_rate_2_rad_s", "rad/s", "q2'"),
    Port("held_1", "N m", "torques of joint 1 on their way", size=DELAY_SIZE, recorded=False),
    Port("held_2", "N m", "torques of joint 2 on their way", size=DELAY_SIZE, recorded=False),
)
HELD_1, HELD_2 = 4, 4 + DELAY_SIZE


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Advance to t, sample; see the module header."""
    middle = t - 0.5 * dt  # of the period: its ends are rounded
    loaded = (middle >= p[FROM]) & (middle < p[TO])
    y[10] = p[M2] + where(loaded, p[PAYLOAD], 0.0)
    if t > 0.0:
        y[8] = rounded(delayed(u[0], p[DELAY], x, HELD_1), p[TORQUE_LSB])
        y[9] = rounded(delayed(u[1], p[DELAY], x, HELD_2), p[TORQUE_LSB])
        for _ in range(int(p[SUBSTEPS])):
            arm.advance(p, p[M1], y[10], dt / p[SUBSTEPS], y[8], y[9], x)
    for i in range(2):
        y[i] = rounded(x[i], p[POSITION_LSB])
        y[2 + i] = rounded(x[2 + i], p[RATE_LSB])
    for i in range(4):
        y[4 + i] = x[i]


BLOCK = Block(step, inputs=INPUTS, outputs=OUTPUTS, states=STATES, settings=SETTINGS)
