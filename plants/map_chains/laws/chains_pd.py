"""PD with a model for two chains with an input each: what one step of either is to be given.

    e3 = x3 - x_d(k),  e2 = x2 - x_d(k-1),  e1 = x1 - x_d(k-2)          x3 the newest        (1)
    r  = e3 + lam e2 + lam_2 e1                                                              (2)
    tau_d(k) = x_d(k+1) - lam e3 - lam_2 e2 - F + Kv r                  F: equations.py (1)  (3)
    u(k) = tau_d(k)                                                                          (4)

of either chain, a and b, gives r(k+1) = Kv r(k) - (tau_d(k) - tau(k)) in each. e follows r where
the roots of z^2 + lam z + lam_2 lie inside the unit circle. With lam_2 = 0 and `order` 2 a chain
without coupling has the law of `map_pd.py`, bit for bit.

Beyond |r| = r_max a chain's law is latched off and sends 0: `a_diverged`, `b_diverged`. Without
units. Source: Lewis, Campos, Selmic (SIAM 2002), chapters 4.3 and 5.3, for n states and m inputs.
"""

from collections.abc import Callable

from pcpc.executive.laws.block import Block, Ports, group, inline, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.families.maps.laws import map_pd
from pcpc.plants.map_chains.equations import chain_drift


class Gains(map_pd.Gains):
    """The filtered error and the model, of both chains."""

    lam_2 = port("", "lam_2 of the filtered error; 0 for second order", 0.0, -1.0, 1.0)
    order = port("", "2 or 3, of the model", 2.0, 2.0, 3.0)
    model_coupling = port("", "kappa of the model, between the chains", 0.0, -10.0, 10.0)


class Chain(Ports):
    """Of one chain: four values of the reference, and its states."""

    older = port("", "x_d(k-2)")
    x_d_previous = port("", "x_d(k-1)")
    x_d = port("", "x_d(k)")
    x_d_next = port("", "x_d(k+1)")
    x1 = port("", "measured x1, the oldest")
    x2 = port("", "measured x2")
    x3 = port("", "measured x3, the newest")


class Inputs(Ports):
    """Of both chains."""

    a = group(Chain, "a_")
    b = group(Chain, "b_")


class States(Ports):
    """The latches."""

    a = group(map_pd.States, "a_")
    b = group(map_pd.States, "b_")


class ChainOutputs(Ports):
    """Of one chain: the command and what led to it."""

    command = port("", "u, 0 once latched off")
    e = port("", "e3")
    r = port("", "r")
    tau_d = port("", "tau_d (3)")
    diverged = port("", "1 once the law was latched off")


class Outputs(Ports):
    """Of both chains."""

    a = group(ChainOutputs, "a_")
    b = group(ChainOutputs, "b_")
    ahead = port("", "1: commands are for the step after the sample's")


@inline
def desired(p: Gains, u: Chain, other: float, y: ChainOutputs) -> None:
    """Write e3 (1), r (2) and tau_d (3) of one chain; `other`: the newest state of the other."""
    e2 = u.x2 - u.x_d_previous
    y.e = u.x3 - u.x_d
    y.r = y.e + p.lam * e2 + p.lam_2 * (u.x1 - u.older)
    model = chain_drift(u.x1, u.x2, u.x3, other, p.order, p.model_c, p.model_coupling)
    y.tau_d = u.x_d_next - p.lam * y.e - p.lam_2 * e2 - model + p.kv * y.r


@inline
def step_chain(p: Gains, u: Chain, other: float, x: map_pd.States, y: ChainOutputs) -> None:
    """Make a tick of one chain."""
    desired(p, u, other, y)
    y.command = where(map_pd.is_sound(p, x, y), y.tau_d, 0.0)  # (4)


@inline
def step_both(of_one: Callable[..., None], p: Ports, x: Ports, u: Ports, y: Ports) -> None:
    """Make a tick of both chains; `of_one` is a law's `step_chain`."""
    of_one(p, u.a, u.b.x3, x.a, y.a)
    of_one(p, u.b, u.a.x3, x.b, y.b)


@stage
def step(t: float, dt: float, p: Gains, x: States, u: Inputs, y: Outputs) -> None:
    """One tick; see the module header."""
    step_both(step_chain, p, x, u, y)
    y.ahead = 0.0


BLOCK = Block(step)
