"""Backlash compensation of the second-order map by dynamic inversion with prediction.

    u(k+1) = clip(-Kb tt + tau_d(k) + g + W's, +-u_max)    gap_inverse.py (1) to (7)         (1)
    tau_d(k), r                                            map_pd.py (1) (2)                 (2)

The answer to the sample of k is for step k+1, since the inverse needs the next desired torque:
`ahead` 1. So the law holds exactly one sample of transport, and one more makes it unstable.

V is drawn uniform in +-1 from `network_seed`.

Beyond |r| = r_max the law is latched off and sends 0: `diverged`. Without units.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 5.3; all gains are chosen.
"""

from collections.abc import Mapping

from pcpc.executive.laws.approximators.two_layer import first_layer
from pcpc.executive.laws.block import Block, Prepared, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.families.maps.laws import map_pd
from pcpc.plants.families.maps.laws.gap_inverse import (
    INPUTS,
    NODES,
    Inversion,
    InversionOutputs,
    States,
    inverse_command,
)


class Parameters(map_pd.Gains, Inversion):
    """Those of the PD law, the inversion's and the network's."""


class Settings(Parameters):
    """The parameters, and what draws the first layer."""

    network_seed = port("", "draws V", 1.0, 0.0, 2.0**31)


class Inputs(map_pd.Inputs):
    """Those of the PD law, and the torque."""

    tau = port("", "measured tau")


class Outputs(map_pd.Outputs, InversionOutputs):
    """Those of the PD law, the inversion's and the network's."""


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and V (6, 10), drawn uniform in +-1."""
    return Prepared(settings, {"v": first_layer(settings["network_seed"], INPUTS, NODES)})


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One step of the map; see the module header."""
    map_pd.desired(p, u, y)
    going = map_pd.is_sound(p, x, y)
    command = inverse_command(p, going, u, x, y)
    y.command = where(going, command, 0.0)
    y.ahead = 1.0


BLOCK = Block(step, settings=Settings, prepare=prepare)
