"""The compiled arm and its law wired directly, without bus, rounding and limits, for tests."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from pcpc.executive.laws.block import Block, Port
from pcpc.executive.laws.controllers.arm import friction_nn, network_inputs
from pcpc.plants.friction_arm import model

Vector = NDArray[np.float64]
FOLDER = Path(model.__file__).parent
_RIG = yaml.safe_load((FOLDER / "rig.yaml").read_text())
_GROUPS = yaml.safe_load((FOLDER / "parameters.yaml").read_text())
ARM = {name: entry["value"] for group in _GROUPS.values() for name, entry in group.items()}
LAW = _RIG["controllers"]["nn_step"]["parameters"]


def defaults(ports: tuple[Port, ...]) -> dict[str, float]:
    """Return the ports' own defaults."""
    return {port.name: port.default for port in ports if port.default is not None}


def views(block: Block, rate_hz: float, settings: dict[str, float]) -> tuple[Vector, Vector]:
    """Return parameters and states of a block as its step wants them."""
    prepared = block.prepare({**defaults(block.settings), **settings}, rate_hz, 1)  # type: ignore[misc]

    def packed(ports: tuple[Port, ...], values: Any) -> Vector:
        return np.concatenate(
            [np.broadcast_to(values.get(port.name, 0.0), (port.size,)) for port in ports]
        ).astype(np.float64)

    return (
        packed(block.parameters, prepared.parameters),
        packed(block.states, prepared.states),
    )


class Loop:
    """Arm and network law at `rate_hz` towards a unit step; iterate for (t, arm, law) outputs."""

    def __init__(self, rate_hz: float = 1000.0, **settings: float) -> None:
        """Take `settings` of the arm or of the law, by name."""
        arm = {port.name for port in model.BLOCK.settings}
        mine = {k: v for k, v in settings.items() if k in arm}
        law = {k: v for k, v in settings.items() if k not in arm}
        self.dt = 1.0 / rate_hz
        self.p, self.x = views(model.BLOCK, rate_hz, ARM | mine)
        self.law_p, self.law_x = views(friction_nn.BLOCK, rate_hz, LAW | law)
        self.y = np.zeros(model.Outputs.size)
        self.law_y = np.zeros(friction_nn.Outputs.size)
        self.law_u = np.zeros(network_inputs.Inputs.size)
        network_inputs.Inputs(self.law_u).q_d_rad[:] = 1.0

    def run(self, cycles: int) -> Iterator[tuple[float, Vector, Vector]]:
        """Step both; yield after the law's step."""
        for k in range(cycles):
            t = k * self.dt
            model.step(t, self.dt, self.p, self.x, self.law_y[:2], self.y)
            self.law_u[4:8] = self.y[:4]
            friction_nn.step(t, self.dt, self.law_p, self.law_x, self.law_u, self.law_y)
            yield t, self.y, self.law_y
