"""A block: parameters, state, inputs and outputs with names and units, and one pure `step`.

    @stage
    def step(t: float, dt: float, p: Gains, x: States, u: Inputs, y: Outputs) -> None:
        y.motor_torque_Nm = p.kv_Nms_rad * (u.q_d_rad - u.encoder_rad)

    BLOCK = Block(step)

t, dt in s. The annotations name declarations (`executive.laws.ports`); a block without states
takes `x: Nothing`.

A step may use + - * /, sqrt, abs, comparisons, `where(c, a, b)` where a choice depends on a state,
written loops, and the functions of `executive.laws.emath`. It must not use libm, numpy reductions,
`**` (write x*x), clocks, buses, files, allocation or globals. Then compiled and interpreted runs
are bit-identical on every machine.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.stage import Stage, stage
from pcpc.drivers.compiled.views import Array, flat
from pcpc.executive.laws.ports import Nothing, Port, Ports, group, port, required

__all__ = [
    "Array", "Block", "Nothing", "Port", "Ports", "Prepared", "flat", "group", "inline", "port",
    "required", "stage",
]  # fmt: skip


@dataclass(frozen=True)
class Prepared:
    """What `prepare` returns: values by port name, a float or a sequence (size,) of the port."""

    parameters: Mapping[str, float | Sequence[float]]
    states: Mapping[str, float | Sequence[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Block:
    """A stage and the settings that a rig gives it.

    `settings` declares them if they are not the parameters. `prepare(settings, rate_hz, seed)` then
    computes parameters and initial states once, at set-up:

        def prepare(settings, rate_hz, seed):    # settings: those of `p` and begin_m
            return Prepared(settings, {"level_m": settings["begin_m"]})

        BLOCK = Block(step, Settings, prepare)

    TypeError: the step is no stage.
    """

    step: Stage
    settings: Any = None  # a declaration; afterwards its ports
    prepare: Callable[[Mapping[str, float], float, int], Prepared] | None = None
    parameters: tuple[Port, ...] = field(init=False)
    states: tuple[Port, ...] = field(init=False)
    inputs: tuple[Port, ...] = field(init=False)
    outputs: tuple[Port, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Take the ports from the stage."""
        if not isinstance(self.step, Stage):
            raise TypeError("the step is plain Python; put @stage above its def")
        kinds = ("parameters", "states", "inputs", "outputs")
        for kind, ports in zip(kinds, self.step.declared, strict=True):
            object.__setattr__(self, kind, ports.ports)
        given = self.parameters if self.settings is None else self.settings.ports
        object.__setattr__(self, "settings", given)

    def with_units(self, of: Callable[[str], str]) -> "Block":
        """Return the same block with the unit `of` each port's unit; its step is the same code."""
        copied = copy.copy(self)
        for kind in ("settings", "parameters", "states", "inputs", "outputs"):
            ports = (replace(one, unit=of(one.unit)) for one in getattr(self, kind))
            object.__setattr__(copied, kind, tuple(ports))
        return copied

    def size(self, ports: Sequence[Port]) -> int:
        """Return the number of float64 values of these ports."""
        return sum(port.size for port in ports)
