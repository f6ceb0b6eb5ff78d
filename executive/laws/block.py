"""A block: parameters, state, inputs and outputs with names and units, and one pure `step`.

    step(t, dt, p, x, u, y)     t, dt: float, s.  p, x, u, y: float64 views of the block's
                                parameters, state, inputs and outputs.  Returns nothing.

Inside a step: + - * /, sqrt, abs, comparisons, `where(c, a, b)` for what depends on a state,
written loops, and the functions of `executive.laws.emath`. No libm, no numpy reductions, no `**`
but x*x, no clock, bus, file, allocation or global. Then compiled and interpreted runs give the same
bits on every machine.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pcpc.drivers.jit import inline
from pcpc.drivers.stage import stage
from pcpc.executive.laws.ports import Port, Ports, group, port

__all__ = ["Block", "Port", "Ports", "Prepared", "group", "inline", "port", "stage"]


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

    step: Any  # a Stage
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
