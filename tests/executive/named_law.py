"""The compiled step of a law on vectors of its own, its state and outputs by name, for tests."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pcpc.executive.laws.block import Block, Prepared


class Law:
    """A law with its settings, from `prepare` where it has one; all ports have to be given."""

    def __init__(self, block: Block, settings: Mapping[str, float]) -> None:
        self.block = block
        _, states, _, self.outputs = block.step.declared
        made = block.prepare(settings, 1000.0, 1) if block.prepare else Prepared(settings)
        self.p = np.array([made.parameters[port.name] for port in block.parameters])
        self.x: Any = states(np.zeros(states.size))
        self.y: Any = self.outputs(np.zeros(self.outputs.size))
        for name, values in made.states.items():
            getattr(self.x, name).ravel()[:] = values

    def step(self, u: ArrayLike, dt: float = 1e-3) -> Any:
        """Step with these inputs, in order; return a copy of the outputs."""
        inputs = np.asarray(u, float)
        self.block.step(0.0, dt, self.p, self.x.values(), inputs, self.y.values())
        return self.outputs(self.y.values().copy())

    def copies(self, *names: str) -> dict[str, Any]:
        """Return copies of these states."""
        return {name: getattr(self.x, name).copy() for name in names}
