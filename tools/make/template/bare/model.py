"""A first-order lag, one input and one output: write your own plant in its place.

    T y' = u - y                                                                    (1)

    call k of `step` at t = k dt:  k = 0  sample y
                                   k > 0  integrate [t - dt, t] with the u held so far, take the
                                          new one, sample

So a command computed from the sample of t_k acts from t_k+1, as on real hardware. With u held the
step is exact:

    y+ = u + (y - u) exp(-dt/T)                                                     (1')
"""

from pcpc.executive.laws.block import Block, Ports, port, stage
from pcpc.executive.laws.emath import exp


class Parameters(Ports):
    """Each with unit, meaning, default (None: rig.yaml says it), lowest and highest value."""

    time_constant_s = port("s", "T", None, 1e-3, 1e3)


class States(Ports):
    """What is integrated, and the input in force."""

    y = port("", "y")
    held = port("", "u, until the next call")


class Inputs(Ports):
    """What came over the bus."""

    command = port("", "newest valid command")


class Outputs(Ports):
    """What goes over the bus."""

    output = port("", "y", low=-100.0, high=100.0)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One period of the plant."""
    if t > 0.0:
        x.y = x.held + (x.y - x.held) * exp(-dt / p.time_constant_s)  # (1')
        x.held = u.command
    y.output = x.y


BLOCK = Block(step)
