"""Fuzzy precompensators of two deadzones, in front of two chains: four widths are learned.

    tau_d, r             of either chain             chains_pd.py (1) to (3)                 (1)
    u = tau_d + d+ X_1 + d- X_2, and tuning by r     fuzzy_widths.py (1) to (4)              (2)

A deadzone stands in front of one input, so that the matrix of widths is diagonal: a chain's r
tunes its own two. Without coupling of the chains either is the law of `deadzone_fuzzy.py`.
Without units. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.3, for m inputs.
"""

from pcpc.executive.laws.block import Block, Ports, group, inline, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.families.maps.laws import fuzzy_widths
from pcpc.plants.families.maps.laws.map_pd import is_sound
from pcpc.plants.map_chains.laws import chains_pd


class Parameters(chains_pd.Gains, fuzzy_widths.Tuning):
    """Those of PD, and of the tuning."""


class States(Ports):
    """The guards, the widths, and which rules fired."""

    a = group(fuzzy_widths.States, "a_")
    b = group(fuzzy_widths.States, "b_")


class ChainOutputs(chains_pd.ChainOutputs, fuzzy_widths.Widths):
    """Those of PD, and what was learned."""


class Outputs(Ports):
    """Of both chains."""

    a = group(ChainOutputs, "a_")
    b = group(ChainOutputs, "b_")
    ahead = port("", "1: commands are for the step after the sample's")


@inline
def step_chain(
    p: Parameters, u: chains_pd.Chain, other: float, x: fuzzy_widths.States, y: ChainOutputs
) -> None:
    """Make a tick of one chain."""
    chains_pd.desired(p, u, other, y)
    good = is_sound(p, x, y)
    u_k = fuzzy_widths.compensated_command(p, good, x, y)
    y.command = where(good, u_k, 0.0)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: chains_pd.Inputs, y: Outputs) -> None:
    """One tick; see the module header."""
    chains_pd.step_both(step_chain, p, x, u, y)
    y.ahead = 0.0


BLOCK = Block(step)
