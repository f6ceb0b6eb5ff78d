"""Neural inversion of two gaps, in front of two chains: a network for each input.

    tau_d, r                                        of either chain, chains_pd.py (1) to (3) (1)
    u(k+1) = clip(-Kb tt + tau_d + g + W's)         gap_inverse.py (1) to (7)                (2)

Each chain has its own network, tuned by its own errors: what one gap does is no function of the
other's inputs. Without coupling of the chains either is the law of `backlash_nn_discrete.py`.
V of chain a is drawn from `network_seed`, that of b from the seed after it.
Without units. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 5.3, for m inputs.
"""

from collections.abc import Mapping

from pcpc.executive.laws.approximators.two_layer import first_layer
from pcpc.executive.laws.block import Block, Ports, Prepared, group, inline, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.families.maps.laws import gap_inverse
from pcpc.plants.families.maps.laws.map_pd import is_sound
from pcpc.plants.map_chains.laws import chains_pd


class Parameters(chains_pd.Gains, gap_inverse.Inversion):
    """Those of PD, the inversion's and the networks'."""


class Settings(Parameters):
    """The parameters, and what draws the first layers."""

    network_seed = port("", "draws V of chain a; the next one that of b", 1.0, 0.0, 2.0**31)


class States(Ports):
    """Of both chains."""

    a = group(gap_inverse.States, "a_")
    b = group(gap_inverse.States, "b_")


class Chain(chains_pd.Chain):
    """Those of PD, and the torque."""

    tau = port("", "measured tau")


class Inputs(Ports):
    """Of both chains."""

    a = group(Chain, "a_")
    b = group(Chain, "b_")


class ChainOutputs(chains_pd.ChainOutputs, gap_inverse.InversionOutputs):
    """Those of PD, the inversion's and the network's."""


class Outputs(Ports):
    """Of both chains."""

    a = group(ChainOutputs, "a_")
    b = group(ChainOutputs, "b_")
    ahead = port("", "1: commands are for the step after the sample's")


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and V (6, 10) of both, drawn uniform in +-1."""
    seed_a, shape = settings["network_seed"], (gap_inverse.INPUTS, gap_inverse.NODES)
    layers = {"a_v": first_layer(seed_a, *shape), "b_v": first_layer(seed_a + 1.0, *shape)}
    return Prepared(settings, layers)


@inline
def step_chain(
    p: Parameters, u: Chain, other: float, x: gap_inverse.States, y: ChainOutputs
) -> None:
    """Make a tick of one chain."""
    chains_pd.desired(p, u, other, y)
    going = is_sound(p, x, y)
    command = gap_inverse.inverse_command(p, going, u, x, y)
    y.command = where(going, command, 0.0)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One tick; see the module header."""
    chains_pd.step_both(step_chain, p, x, u, y)
    y.ahead = 1.0


BLOCK = Block(step, settings=Settings, prepare=prepare)
