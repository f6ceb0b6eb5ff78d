"""The second-order map behind a deadzone: command in, both states out.

    x1(k+1) = x2(k)
    x2(k+1) = F(x1, x2) + tau(k)        plants/families/maps/equations.py                    (1)
    tau(k)  = D(u(k))                   plants/actuators/deadzone.py, slope 1, unmeasured  (2)

    call k of `step`:  k = 0  sample of the initial state; nothing else happens
                       k > 0  one step of (1) with the command of `delay_samples` calls before,
                              then sample

At call k the input is the answer to sample k-1, so that (1) with `delay_samples` 0 is the book's
map. Without units: no rad, no N m. A period is 0.1 s in the book and stands in the reference only.
A resolution of 0 means none.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.3; the map as in families/maps.
"""

from pcpc.executive.laws.block import Block, Ports, group, port, stage
from pcpc.plants.actuators.deadzone import deadzone
from pcpc.plants.families.maps.equations import drift
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed


class Parameters(Ports):
    """The map, the deadzone, and what is between them and the law."""

    c = port("", "coefficient of F", None, 0.0, 1.0)
    d = port("", "half width of the deadzone; 0 for none", None, 0.0, 10.0)
    delay_samples = port("", "whole samples of transport", 0.0, 0.0, DELAY_SIZE - 1.0)
    x_lsb = port("", "resolution of the sensors", 0.0, 0.0, 1.0)


class Map(Ports):
    """Where the map is."""

    x1 = port("", "x1")
    x2 = port("", "x2")


class States(Ports):
    """The map, and commands on their way."""

    now = group(Map, "x_")
    sent = port("", "commands on their way", shape=DELAY_SIZE, recorded=False)


class Inputs(Ports):
    """The law's command."""

    command = port("", "newest command")


class Outputs(Ports):
    """Samples and truths."""

    sample = group(Map, "sample_")
    true = group(Map)
    tau = port("", "input of (1) in the step that ends here")


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Make the step that ends at t and sample; at t = 0 only sample."""
    now = x.now
    if t > 0.0:
        y.tau = deadzone(delayed(u.command, p.delay_samples, x.sent), p.d, p.d)  # (2)
        now.x1, now.x2 = now.x2, drift(now.x1, now.x2, p.c) + y.tau  # (1)
    y.true.x1, y.true.x2 = now.x1, now.x2
    y.sample.x1, y.sample.x2 = rounded(now.x1, p.x_lsb), rounded(now.x2, p.x_lsb)


BLOCK = Block(step)
