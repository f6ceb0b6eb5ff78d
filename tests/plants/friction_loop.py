"""The compiled arm and its law wired directly, without bus, rounding and limits, for tests."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from stepped import Stepped, gains

from pcpc.plants.families.two_link.laws import network_inputs
from pcpc.plants.friction_arm import model
from pcpc.plants.friction_arm.laws import friction_nn

Vector = NDArray[np.float64]
FOLDER = Path(model.__file__).parent
_GROUPS = yaml.safe_load((FOLDER / "parameters.yaml").read_text())
ARM = {name: entry["value"] for group in _GROUPS.values() for name, entry in group.items()}
LAW = gains(FOLDER)["nn_step"]


class Loop:
    """Arm and network law at `rate_hz` towards a unit step; iterate for (t, arm, law) outputs."""

    def __init__(self, rate_hz: float = 1000.0, **settings: float) -> None:
        """Take `settings` of the arm or of the law, by name."""
        of_arm = {port.name for port in model.BLOCK.settings}
        mine = {k: v for k, v in settings.items() if k in of_arm}
        law = {k: v for k, v in settings.items() if k not in of_arm}
        self.arm = Stepped(model.BLOCK, ARM | mine, 1.0 / rate_hz)
        self.law = Stepped(friction_nn.BLOCK, LAW | law, 1.0 / rate_hz)
        self.u = network_inputs.Inputs(np.zeros(network_inputs.Inputs.size))
        self.u.q_d_rad[:] = 1.0

    def run(self, cycles: int) -> Iterator[tuple[float, Any, Any]]:
        """Step both; yield after the law's step."""
        for k in range(cycles):
            arm = self.arm.step(*self.law.y.torque_Nm)
            self.u.q_rad[:], self.u.rate_rad_s[:] = arm.sample.q_rad, arm.sample.rate_rad_s
            yield k * self.arm.dt, arm, self.law.step(*self.u.values())
