"""The second-order map behind a deadzone: command in, both states out.

    x1(k+1) = x2(k)
    x2(k+1) = F(x1, x2) + tau(k)        executive/laws/models/second_order_map.py                (1)
    tau(k)  = D(u(k))                   plants/actuators/deadzone.py, slope 1, unmeasured    (2)

    call k of `step`:  k = 0  sample of the initial state; nothing else happens
                       k > 0  one step of (1) with the command of `delay_samples` calls before,
                              then sample

At call k the input is the answer to sample k-1, so that (1) with `delay_samples` 0 is the book's
map. Without units: no rad, no N m. A period is 0.1 s in the book and stands in the reference only.
A resolution of 0 means none.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.3; the map as in executive/models.
"""

from typing import Any

from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.models.second_order_map import drift
from pcpc.plants.actuators.deadzone import deadzone
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed

SETTINGS = (
    Port("c", "", "coefficient of F", None, 0.0, 1.0),
    Port("d", "", "half width of the deadzone; 0 for none", None, 0.0, 10.0),
    Port("delay_samples", "", "whole samples of transport", 0.0, 0.0, DELAY_SIZE - 1.0),
    Port("x_lsb", "", "resolution of the sensors", 0.0, 0.0, 1.0),
)
C, D, DELAY, X_LSB = range(len(SETTINGS))
OUTPUTS = (
    Port("x1", "", "sample of x1"),
    Port("x2", "", "sample of x2"),
    Port("true_x1", "", "x1"),
    Port("true_x2", "", "x2"),
    Port("tau", "", "input of (1) in the step that ends here"),
)
STATES = (
    Port("x_x1", "", "x1", 0.0),
    Port("x_x2", "", "x2", 0.0),
    Port("sent", "", "commands on their way", size=DELAY_SIZE, recorded=False),
)
SENT = 2


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Make the step that ends at t and sample; at t = 0 only sample."""
    if t > 0.0:
        y[4] = deadzone(delayed(u[0], p[DELAY], x, SENT), p[D], p[D])  # (2)
        following = drift(x[0], x[1], p[C]) + y[4]  # (1)
        x[0] = x[1]
        x[1] = following
    for i in range(2):
        y[i] = rounded(x[i], p[X_LSB])
        y[2 + i] = x[i]


BLOCK = Block(
    step,
    inputs=(Port("u", "", "newest command"),),
    outputs=OUTPUTS,
    states=STATES,
    settings=SETTINGS,
)
