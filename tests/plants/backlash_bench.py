"""Blocks stepped by hand, without a bus, for the tests of both plants behind backlash."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from pcpc.executive.laws.block import Block, Port

Vector = NDArray[np.float64]


def parameters(plant: Path) -> dict[str, float]:
    """Return the values of a plant's parameters.yaml."""
    groups = yaml.safe_load((plant / "parameters.yaml").read_text())
    return {name: entry["value"] for group in groups.values() for name, entry in group.items()}


class Stepped:
    """A block with some settings given, at its start."""

    def __init__(self, block: Block, given: Mapping[str, float], dt: float) -> None:
        values: dict[str, Any] = {port.name: port.default for port in block.settings} | dict(given)
        states: Mapping[str, Any] = {}
        if block.prepare is not None:
            prepared = block.prepare(values, 1.0 / dt, 1)
            values, states = dict(prepared.parameters), prepared.states
        self.block, self.dt, self.k = block, dt, 0
        self.p = vector(block.parameters or block.settings, values)
        self.x = vector(block.states, states)
        self.y = np.zeros(block.size(block.outputs))

    def step(self, *inputs: float) -> Vector:
        """Call the step of the next cycle; return a copy of its outputs."""
        u = np.array(inputs, np.float64)
        self.block.step(self.k * self.dt, self.dt, self.p, self.x, u, self.y)
        self.k += 1
        return self.y.copy()

    def place(self, name: str) -> slice:
        """Return where a state lies in `x`."""
        return place(self.block.states, name)

    def output(self, name: str) -> float:
        """Return an output of the last step."""
        return float(self.y[place(self.block.outputs, name)][0])


def place(ports: Sequence[Port], name: str) -> slice:
    """Return where a port lies in its view."""
    at = 0
    for port in ports:
        if port.name == name:
            return slice(at, at + port.size)
        at += port.size
    raise KeyError(name)


def vector(ports: Sequence[Port], values: Mapping[str, Any]) -> Vector:
    """Return the view of `ports` with `values`, 0 where none is given."""
    out = np.zeros(sum(port.size for port in ports))
    for port in ports:
        out[place(ports, port.name)] = values.get(port.name, port.default or 0.0)
    return out
