"""A block: parameters, state, inputs and outputs with names and units, and one pure `step`.

    step(t, dt, p, x, u, y)     t, dt: float, s.  p, x, u, y: float64 views of the block's
                                parameters, state, inputs and outputs.  Returns nothing.

Inside a step: + - * /, sqrt, abs, comparisons, `where(c, a, b)` for what depends on a state,
written loops, and the functions of `executive.emath`. No libm, no numpy reductions, no `**` but
x*x, no clock, bus, file, allocation or global. Then compiled and interpreted runs give the same
bits on every machine.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from drivers.jit import inline, stage

__all__ = ["Block", "Port", "Prepared", "inline", "stage"]


@dataclass(frozen=True)
class Port:
    """One variable (or `size` of them, named name_0, name_1, ...) of a block.

    `name` is snake_case and ends in its unit where that helps (`hub_rate_rad_s`); `unit` is the
    text that wiring compares ("rad/s", "N m", "" for none); `default` None means that a rig file
    must give it (settings) or that `prepare` does (parameters); a state starts at its default or 0.
    `recorded` False keeps it out of the log: scratch, random generators, weights.
    """

    name: str
    unit: str
    help: str
    default: float | None = None
    low: float = float("-inf")
    high: float = float("inf")
    size: int = 1
    recorded: bool = True

    def names(self) -> list[str]:
        """Return the table names of this port's elements."""
        if self.size == 1:
            return [self.name]
        return [f"{self.name}_{i}" for i in range(self.size)]


@dataclass(frozen=True)
class Prepared:
    """What `prepare` returns: values by port name, a float or a sequence of the port's size."""

    parameters: Mapping[str, float | Sequence[float]]
    states: Mapping[str, float | Sequence[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Block:
    """A step function with its ports, in the order of its views.

    `settings` is what a rig file may set. Where it is empty, the parameters are the settings.
    Otherwise `prepare(settings, rate_hz, seed)` computes parameters and initial states from them,
    once, at set-up.
    """

    step: Callable[..., None]
    inputs: tuple[Port, ...] = ()
    outputs: tuple[Port, ...] = ()
    parameters: tuple[Port, ...] = ()
    states: tuple[Port, ...] = ()
    settings: tuple[Port, ...] = ()
    prepare: Callable[[Mapping[str, float], float, int], Prepared] | None = None

    def size(self, ports: Sequence[Port]) -> int:
        """Return the number of float64 values of these ports."""
        return sum(port.size for port in ports)


Step = Callable[[float, float, Any, Any, Any, Any], None]
