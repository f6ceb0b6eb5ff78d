"""A block: parameters, state, inputs and outputs with names and units, and one pure `step`.

    @stage
    def step(t: float, dt: float, p: Gains, x: States, u: Inputs, y: Outputs) -> None:
        y.motor_torque_Nm = p.kv_Nms_rad * (u.q_d_rad - u.encoder_rad)

    BLOCK = Block(step)

t, dt in s. The annotations name declarations (`executive.laws.ports`); a block without states takes
`x: Nothing`. Returns nothing.

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
from pcpc.drivers.views import flat
from pcpc.executive.laws.ports import Nothing, Port, Ports, group, port

__all__ = [
    "Block", "Nothing", "Port", "Ports", "Prepared", "flat", "group", "inline", "port", "stage",
]  # fmt: skip


@dataclass(frozen=True)
class Prepared:
    """What `prepare` returns: values by port name, a float or a sequence of the port's size."""

    parameters: Mapping[str, float | Sequence[float]]
    states: Mapping[str, float | Sequence[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Block:
    """A step function with its ports, in the order of its views; those a stage declares itself.

    `settings` (a declaration, or ports) is what a rig file may set, where that is not the
    parameters. Then `prepare(settings, rate_hz, seed)` computes parameters and initial states from
    them, once, at set-up.
    """

    step: Any  # a Stage
    inputs: tuple[Port, ...] = ()
    outputs: tuple[Port, ...] = ()
    parameters: tuple[Port, ...] = ()
    states: tuple[Port, ...] = ()
    settings: Any = ()
    prepare: Callable[[Mapping[str, float], float, int], Prepared] | None = None

    def __post_init__(self) -> None:
        """Take the ports from the stage."""
        declared = getattr(self.step, "declared", ())
        kinds = ("parameters", "states", "inputs", "outputs")
        for kind, ports in zip(kinds, declared, strict=False):
            object.__setattr__(self, kind, ports.ports)
        if isinstance(self.settings, type) and issubclass(self.settings, Ports):
            object.__setattr__(self, "settings", self.settings.ports)
        if declared and not self.settings:
            object.__setattr__(self, "settings", self.parameters)

    def size(self, ports: Sequence[Port]) -> int:
        """Return the number of float64 values of these ports."""
        return sum(port.size for port in ports)


Step = Callable[[float, float, Any, Any, Any, Any], None]
