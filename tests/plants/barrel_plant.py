"""The barrel plant on its own, for tests; as a script it prints the bits of 20 steps."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.laws.block import Port
from pcpc.plants.atb1000 import dynamics as dyn
from pcpc.plants.atb1000.model import BLOCK, EXTERNAL, SINES
from pcpc.plants.atb1000.ports import OUTPUTS, PARAMETERS, STATES, load_parameters, offsets

PARAMETERS_FILE = Path(dyn.__file__).with_name("parameters.yaml")
NOMINAL = load_parameters(PARAMETERS_FILE)
LOSSLESS = {
    "zeta1": 0.0, "zeta2": 0.0, "zeta3": 0.0, "gap_rad": 0.0, "cs_Nms_rad": 0.0,
    "friction_model": 0.0, "motor_coulomb_Nm": 0.0, "motor_viscous_Nms_rad": 0.0, "mesh_loss": 0.0,
}  # fmt: skip

Vector = NDArray[np.float64]


def _vector(ports: tuple[Port, ...], values: Any) -> Vector:
    vector = np.zeros(sum(port.size for port in ports))
    for port in ports:
        at = offsets(ports)[port.name]
        vector[at : at + port.size] = values.get(port.name, 0.0)
    return vector


class Plant:
    """The nominal plant with some settings changed, at its start, not yet sampled."""

    def __init__(self, rate_hz: float = 1000.0, seed: int = 1, **settings: float) -> None:
        assert set(settings) <= set(NOMINAL), set(settings) - set(NOMINAL)
        prepared = BLOCK.prepare({**NOMINAL, **settings}, rate_hz, seed)  # type: ignore[misc]
        self.dt = 1.0 / rate_hz
        self.p = _vector(PARAMETERS, prepared.parameters)
        self.x = _vector(STATES, prepared.states)
        self.u = np.zeros(1)
        self.y = np.zeros(len(OUTPUTS))
        self.k = 0

    def step(self, command_Nm: float = 0.0) -> Vector:
        """Call the step of the next tick with this input; return its outputs."""
        self.u[0] = command_Nm
        BLOCK.step(self.k * self.dt, self.dt, self.p, self.x, self.u, self.y)
        self.k += 1
        return self.y.copy()

    def parameter(self, name: str, size: int = 1) -> Vector:
        """Return a parameter port's values (size,)."""
        at = offsets(PARAMETERS)[name]
        return self.p[at : at + size]

    def slopes(self, s: Vector, w: Vector | None = None) -> Vector:
        """Return dx/dt (16,) at state `s` (16,) under external inputs `w` (8,), default none."""
        d = np.zeros(16)
        external = np.zeros(dyn.EXTERNAL) if w is None else w
        external[dyn.STEP_S] = 1.0 / 16000.0
        dyn.derivative(self.p, s, external, d)
        return d

    def external(self) -> Vector:
        """Return the external inputs of the last step."""
        return self.x[EXTERNAL:SINES]


def trace() -> str:
    """Return 20 steps with every part in use, as hex digits of all states and outputs."""
    plant = Plant(hull_motion=1.0, fire=1.0, fire_hub_start_s=0.004, fire_muzzle_start_s=0.007)
    rows = []
    for k in range(20):
        plant.step(0.04 + 1.9 * (-1.0) ** (k // 4))
        rows.append(plant.x.tobytes() + plant.y.tobytes())
    return b"".join(rows).hex()


if __name__ == "__main__":
    print(trace())
