"""Blocks stepped by hand, without a bus, their ports by name, for the tests of plants."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from pcpc.executive.laws.block import Block, Port
from pcpc.executive.rig.reading import load_rig

Vector = NDArray[np.float64]


def parameters(plant: Path) -> dict[str, float]:
    """Return the values of a plant's parameters.yaml."""
    groups = yaml.safe_load((plant / "parameters.yaml").read_text())
    return {name: entry["value"] for group in groups.values() for name, entry in group.items()}


def gains(plant: Path) -> dict[str, dict[str, float]]:
    """Return the parameters that a plant's first rig gives each controller."""
    rig = load_rig(min((plant / "rigs").glob("*.yaml")), resolve=False)
    return {name: law.parameters for name, law in rig.config.controllers.items()}


class Stepped:
    """A block with some settings given, at its start."""

    def __init__(self, block: Block, given: Mapping[str, float], dt: float) -> None:
        values: dict[str, Any] = {port.name: port.default for port in block.settings} | dict(given)
        states: Mapping[str, Any] = {}
        if block.prepare is not None:
            prepared = block.prepare(values, 1.0 / dt, 1)
            values, states = dict(prepared.parameters), prepared.states
        self.block, self.dt, self.k = block, dt, 0
        of_p, of_x, _, self.outputs = block.step.declared
        self.p: Any = of_p(vector(block.parameters, values))
        self.x: Any = of_x(vector(block.states, states))
        self.y: Any = self.outputs(np.zeros(self.outputs.size))

    def step(self, *inputs: float) -> Any:
        """Call the step of the next cycle; return a copy of its outputs."""
        t, u = self.k * self.dt, np.array(inputs, np.float64)
        self.block.step(t, self.dt, self.p.values(), self.x.values(), u, self.y.values())
        self.k += 1
        return self.outputs(self.y.values().copy())


def vector(ports: tuple[Port, ...], values: Mapping[str, Any]) -> Vector:
    """Return the values of `ports` in their order, 0 where none is given."""
    found = [np.broadcast_to(values.get(one.name, one.default or 0.0), one.size) for one in ports]
    return np.concatenate([np.zeros(0), *found])
