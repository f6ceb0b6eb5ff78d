"""Fuzzy precompensators of two deadzones, in front of two chains: four widths are learned.

    tau_d, r             of either chain             chains_pd.py (1) to (3)                 (1)
    u = tau_d + d+ X_1 + d- X_2, and tuning by r     deadzone_fuzzy.py (4) to (8)            (2)

A deadzone stands in front of one input, so that the matrix of widths is diagonal: a chain's r
tunes its own two. Without coupling of the chains either is the law of `deadzone_fuzzy.py`.
Without units. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.3, for m inputs.
"""

from pcpc.executive.laws.block import Block, Ports, group, inline, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.deadzone_map.laws import deadzone_fuzzy
from pcpc.plants.families.maps.laws.map_pd import is_sound
from pcpc.plants.map_chains.laws import chains_pd


class Parameters(chains_pd.Gains):
    """Those of PD, and of the tuning."""

    alpha = port("", "learning rate", None, 0.0, 2.0)
    gam = port("", "Gam, decay of the widths", None, 0.0, 1.0)


class States(Ports):
    """The guards, the widths, and which rules fired."""

    a = group(deadzone_fuzzy.States, "a_")
    b = group(deadzone_fuzzy.States, "b_")


class ChainOutputs(chains_pd.ChainOutputs):
    """Those of PD, and what was learned."""

    d_plus = port("", "width learned on the positive side")
    d_minus = port("", "width learned on the negative side, a magnitude")


class Outputs(Ports):
    """Of both chains."""

    a = group(ChainOutputs, "a_")
    b = group(ChainOutputs, "b_")
    ahead = port("", "1: commands are for the step after the sample's")


@inline
def step_chain(
    p: Parameters, u: chains_pd.Chain, other: float, x: deadzone_fuzzy.States, y: ChainOutputs
) -> None:
    """Make a tick of one chain."""
    chains_pd.desired(p, u, other, y)
    good = is_sound(p, x, y)
    u_k = deadzone_fuzzy.compensated_command(p, good, x, y)
    y.command = where(good, u_k, 0.0)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: chains_pd.Inputs, y: Outputs) -> None:
    """One tick; see the module header."""
    step_chain(p, u.a, u.b.x3, x.a, y.a)
    step_chain(p, u.b, u.a.x3, x.b, y.b)
    y.ahead = 0.0


BLOCK = Block(step)
