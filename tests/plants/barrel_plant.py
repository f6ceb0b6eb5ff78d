"""The barrel plant on its own, for tests."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.laws.block import Ports, stage
from pcpc.plants.atb1000 import dynamics as dyn
from pcpc.plants.atb1000.model import BLOCK
from pcpc.plants.atb1000.ports import (
    External,
    Motion,
    Outputs,
    Parameters,
    States,
    load_parameters,
)

PARAMETERS_FILE = Path(dyn.__file__).with_name("parameters.yaml")
NOMINAL = load_parameters(PARAMETERS_FILE)
LOSSLESS = {
    "zeta1": 0.0, "zeta2": 0.0, "zeta3": 0.0, "gap_rad": 0.0, "cs_Nms_rad": 0.0,
    "friction_model": 0.0, "motor_coulomb_Nm": 0.0, "motor_viscous_Nms_rad": 0.0, "mesh_loss": 0.0,
}  # fmt: skip

Vector = NDArray[np.float64]


NAMES = [port.name for port in Outputs.ports]
AT = {name: i for i, name in enumerate(NAMES)}


@stage
def slopes(t: float, dt: float, p: Parameters, x: Motion, u: External, y: Motion) -> None:
    dyn.derivative(p, x, u, y)


def _vector(ports: type[Ports], values: Any) -> Vector:
    found = [np.broadcast_to(values.get(port.name, 0.0), port.size) for port in ports.ports]
    return np.concatenate(found).astype(float)


class Plant:
    """The nominal plant with some settings changed, at its start, not yet sampled."""

    def __init__(self, rate_hz: float = 1000.0, seed: int = 1, **settings: float) -> None:
        assert set(settings) <= set(NOMINAL), set(settings) - set(NOMINAL)
        prepared = BLOCK.prepare({**NOMINAL, **settings}, rate_hz, seed)  # type: ignore[misc]
        self.dt = 1.0 / rate_hz
        self.p = _vector(Parameters, prepared.parameters)
        self.x = _vector(States, prepared.states)
        self.u = np.zeros(1)
        self.y = np.zeros(Outputs.size)
        self.k = 0

    def step(self, command_Nm: float = 0.0) -> Vector:
        """Call the step of the next tick with this input; return its outputs."""
        self.u[0] = command_Nm
        BLOCK.step(self.k * self.dt, self.dt, self.p, self.x, self.u, self.y)
        self.k += 1
        return self.y.copy()

    @property
    def parameters(self) -> Parameters:
        """The parameters by name."""
        return Parameters(self.p)

    @property
    def states(self) -> States:
        """The states by name; what is set is set in `x`."""
        return States(self.x)

    def slopes(self, s: Motion, w: External | None = None) -> Motion:
        """Return the derivative at `s` under external inputs `w`, default none."""
        d, outside = np.zeros(Motion.size), External(np.zeros(External.size)) if w is None else w
        outside.step_s = 1.0 / 16000.0
        slopes(0.0, self.dt, self.p, s.values(), outside.values(), d)
        return Motion(d)
