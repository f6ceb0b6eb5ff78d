"""The second-order map behind a gap: command in, both states and what acts on them out.

    x1(k+1) = x2(k)
    x2(k+1) = F(x1, x2) + tau(k)            plants/families/maps/equations.py                    (1)
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

from pcpc.executive.laws.block import Block, Ports, group, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.actuators.backlash import backlash
from pcpc.plants.families.maps.equations import drift
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed


class Parameters(Ports):
    """The map, the gap, and what is between them and the law."""

    c = port("", "coefficient of F", None, 0.0, 1.0)
    d_plus = port("", "d+, command at which rising tau leaves zero", None, 0.0, 10.0)
    d_minus = port("", "d-, the same for falling tau, negative", None, -10.0, 0.0)
    slope = port("", "m, of tau over the command in contact", None, 1e-3, 1e3)
    delay_samples = port("", "whole samples of transport", None, 0.0, DELAY_SIZE - 1.0)
    x_lsb = port("", "quantum of the samples of x, 0 none", None, 0.0, 1.0)
    tau_lsb = port("", "quantum of the samples of tau, 0 none", None, 0.0, 1.0)
    command_lsb = port("", "quantum of the command that acts, 0 none", None, 0.0, 1.0)


class Map(Ports):
    """Where the map is."""

    x1 = port("", "x1")
    x2 = port("", "x2")
    tau = port("", "tau behind the gap")


class States(Ports):
    """The map, and commands on their way."""

    now = group(Map, "x_")
    sent = port("", "commands on their way", shape=DELAY_SIZE, recorded=False)


class Inputs(Ports):
    """The law's command."""

    command = port("", "newest valid command")
    ahead = port("", "1: the command is for the coming step, 0: for the one to make now")


class Outputs(Ports):
    """Samples and truths."""

    sample = group(Map, "sample_")
    true = group(Map)
    acting = port("", "truth: the command before the gap")


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Make the step that ends at t and sample; at t = 0 only sample."""
    now = x.now
    if t > 0.0:
        y.acting = rounded(delayed(u.command, p.delay_samples, x.sent), p.command_lsb)
        moved = backlash(now.tau, y.acting, p.d_plus, p.d_minus, p.slope)  # (2)
        tau = where(u.ahead > 0.5, now.tau, moved)
        now.x1, now.x2 = now.x2, drift(now.x1, now.x2, p.c) + tau  # (1)
        now.tau = moved
    y.true.x1, y.true.x2, y.true.tau = now.x1, now.x2, now.tau
    y.sample.x1, y.sample.x2 = rounded(now.x1, p.x_lsb), rounded(now.x2, p.x_lsb)
    y.sample.tau = rounded(now.tau, p.tau_lsb)


BLOCK = Block(step)
