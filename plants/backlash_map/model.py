"""The second-order map behind a gap: command in, both states and what acts on them out.

    x1(k+1) = x2(k)
    x2(k+1) = F(x1, x2) + tau(k)            executive/laws/models/second_order_map.py            (1)
    tau(k)  = play(tau(k-1), u(k))          actuators/backlash.py (2), slope m, gap d- to d+ (2)

A command says itself which step it is for (`ahead`), so that law and plant cannot disagree:

    call k of `step`:  k = 0      sample x(0), tau(0)
                       ahead = 0  the input is u(k-1), the answer to x(k-1): (2), then (1);
                                  sample x(k) and the tau(k-1) that led to it
                       ahead = 1  the input is u(k), foretold from the samples of k-1: (1) with
                                  tau(k-1), then (2); sample x(k) and tau(k) together

`delay_samples` more and a command comes so many steps too late. A sample is rounded to a multiple
of its `..._lsb`, half up; so is the command that acts. 0 does not round. x(0) = 0, tau(0) = 0.

Without units: no rad, no N m. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 5.3; the map is
that of chapter 4.3.
"""

from typing import Any

from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.emath import where
from pcpc.executive.laws.models.second_order_map import drift
from pcpc.plants.actuators.backlash import backlash
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed

SETTINGS = (
    Port("c", "", "coefficient of F", None, 0.0, 1.0),
    Port("d_plus", "", "d+, command at which rising tau leaves zero", None, 0.0, 10.0),
    Port("d_minus", "", "d-, the same for falling tau, negative", None, -10.0, 0.0),
    Port("slope", "", "m, of tau over the command in contact", None, 1e-3, 1e3),
    Port("delay_samples", "", "whole samples of transport", None, 0.0, DELAY_SIZE - 1.0),
    Port("x_lsb", "", "quantum of the samples of x, 0 none", None, 0.0, 1.0),
    Port("tau_lsb", "", "quantum of the samples of tau, 0 none", None, 0.0, 1.0),
    Port("command_lsb", "", "quantum of the command that acts, 0 none", None, 0.0, 1.0),
)
C, D_PLUS, D_MINUS, SLOPE, DELAY, X_LSB, TAU_LSB, COMMAND_LSB = range(len(SETTINGS))
STATES = (
    Port("x_x1", "", "x1"),
    Port("x_x2", "", "x2"),
    Port("x_tau", "", "tau"),
    Port("sent", "", "commands on their way", size=DELAY_SIZE, recorded=False),
)
X1, X2, TAU, SENT = range(len(STATES))
INPUTS = (
    Port("command", "", "newest valid command"),
    Port("ahead", "", "1: the command is for the coming step, 0: for the one to make now"),
)
OUTPUTS = (
    Port("x1", "", "sensor: x1"),
    Port("x2", "", "sensor: x2"),
    Port("tau", "", "sensor: tau behind the gap"),
    Port("true_x1", "", "truth: x1"),
    Port("true_x2", "", "truth: x2"),
    Port("true_tau", "", "truth: tau"),
    Port("acting", "", "truth: the command before the gap"),
)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Make the step that ends at t and sample; at t = 0 only sample."""
    if t > 0.0:
        acting = rounded(delayed(u[0], p[DELAY], x, SENT), p[COMMAND_LSB])
        moved = backlash(x[TAU], acting, p[D_PLUS], p[D_MINUS], p[SLOPE])  # (2)
        following = drift(x[X1], x[X2], p[C]) + where(u[1] > 0.5, x[TAU], moved)  # (1)
        x[X1] = x[X2]
        x[X2] = following
        x[TAU] = moved
        y[6] = acting
    y[0] = rounded(x[X1], p[X_LSB])
    y[1] = rounded(x[X2], p[X_LSB])
    y[2] = rounded(x[TAU], p[TAU_LSB])
    y[3] = x[X1]
    y[4] = x[X2]
    y[5] = x[TAU]


BLOCK = Block(step, inputs=INPUTS, outputs=OUTPUTS, states=STATES, settings=SETTINGS)
