"""Two chains with an input each, behind deadzones or gaps: commands in, all states out.

    x1(k+1) = x2(k),  x2(k+1) = x3(k),  x3(k+1) = F + tau(k)      of either chain, a and b,
                      F: equations.py, order 2 or 3, coupled by kappa                        (1)
    tau(k) = play(tau(k-1), D(u(k)))       actuators/deadzone.py (2), then backlash.py (2)   (2)

A deadzone of width 0 is none, nor is a gap of width 0 and slope 1: with one of them so, (2) is the
other. Each chain has its own. A command says itself which step it is for (`ahead`), as the map of
chapter 5.3, of which `plants/backlash_map/model.py` tells; a delay and quanta as there.

    call k of `step`:  k = 0      sample x(0), tau(0)
                       ahead = 0  (2) with the answer to x(k-1), then (1)
                       ahead = 1  (1) with tau(k-1), then (2) with what was foretold for k

Without units. Source: Lewis, Campos, Selmic (SIAM 2002), chapters 4.3 and 5.3, for n states and m
inputs; order, coupling and widths are chosen.
"""

from pcpc.executive.laws.block import Block, Ports, group, inline, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.actuators.backlash import backlash
from pcpc.plants.actuators.deadzone import deadzone
from pcpc.plants.map_chains.equations import chain_drift
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed


class Actuator(Ports):
    """What stands before one chain."""

    dead = port("", "half width of the deadzone, 0 for none", 0.0, 0.0, 10.0)
    gap = port("", "half width of the gap, 0 for none", 0.0, 0.0, 10.0)
    slope = port("", "of tau over the command in contact", 1.0, 1e-3, 1e3)


class Parameters(Ports):
    """The chains, their actuators, and what is between them and the law."""

    order = port("", "2 or 3, of both chains", None, 2.0, 3.0)
    c = port("", "coefficient of F", None, 0.0, 1.0)
    coupling = port("", "kappa, of either chain in the other", None, -10.0, 10.0)
    a = group(Actuator, "a_")
    b = group(Actuator, "b_")
    delay_samples = port("", "whole samples of transport", 0.0, 0.0, DELAY_SIZE - 1.0)
    x_lsb = port("", "quantum of the samples of x, 0 none", 0.0, 0.0, 1.0)
    tau_lsb = port("", "quantum of the samples of tau, 0 none", 0.0, 0.0, 1.0)
    command_lsb = port("", "quantum of the commands that act, 0 none", 0.0, 0.0, 1.0)


class Chain(Ports):
    """Where a chain is, its oldest state first."""

    x1 = port("", "x1")
    x2 = port("", "x2")
    x3 = port("", "x3")
    tau = port("", "tau, behind deadzone and gap")


class Held(Chain):
    """A chain, and commands on their way to it."""

    sent = port("", "commands on their way", shape=DELAY_SIZE, recorded=False)


class States(Ports):
    """Both chains."""

    a = group(Held, "x_a_")
    b = group(Held, "x_b_")


class Inputs(Ports):
    """The law's commands."""

    a_command = port("", "newest valid command of chain a")
    b_command = port("", "newest valid command of chain b")
    ahead = port("", "1: the commands are for the coming step, 0: for the one to make now")


class Outputs(Ports):
    """Samples and truths."""

    sample_a = group(Chain, "sample_a_")
    sample_b = group(Chain, "sample_b_")
    a = group(Chain, "a_")
    b = group(Chain, "b_")
    acting_a = port("", "truth: command before chain a's deadzone and gap")
    acting_b = port("", "truth: command before chain b's deadzone and gap")


@inline
def actuator_output(actuator: Actuator, acting: float, tau: float) -> float:
    """Return tau (2) for the command `acting` that comes after `tau`."""
    gap, m = actuator.gap, actuator.slope
    return backlash(tau, deadzone(acting, actuator.dead, actuator.dead), gap, -gap, m)


@inline
def advance_chain(
    p: Parameters, ahead: float, acting: float, actuator: Actuator, other: float, x: Held
) -> None:
    """Make the step (1) (2) of a chain; `other`: the newest state of the other, before it."""
    tau = actuator_output(actuator, acting, x.tau)
    used = where(ahead > 0.5, x.tau, tau)
    newest = chain_drift(x.x1, x.x2, x.x3, other, p.order, p.c, p.coupling) + used  # (1)
    x.x1, x.x2, x.x3 = x.x2, x.x3, newest
    x.tau = tau


@inline
def write_samples(p: Parameters, x: Held, sample: Chain, true: Chain) -> None:
    """Write sample and truth of a chain."""
    true.x1, true.x2, true.x3, true.tau = x.x1, x.x2, x.x3, x.tau
    sample.x1, sample.x2 = rounded(x.x1, p.x_lsb), rounded(x.x2, p.x_lsb)
    sample.x3, sample.tau = rounded(x.x3, p.x_lsb), rounded(x.tau, p.tau_lsb)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Make the step that ends at t and sample; at t = 0 only sample."""
    if t > 0.0:
        y.acting_a = rounded(delayed(u.a_command, p.delay_samples, x.a.sent), p.command_lsb)
        y.acting_b = rounded(delayed(u.b_command, p.delay_samples, x.b.sent), p.command_lsb)
        a, b = x.a.x3, x.b.x3
        advance_chain(p, u.ahead, y.acting_a, p.a, b, x.a)
        advance_chain(p, u.ahead, y.acting_b, p.b, a, x.b)
    write_samples(p, x.a, y.sample_a, y.a)
    write_samples(p, x.b, y.sample_b, y.b)


BLOCK = Block(step)
