"""What came of a fit: parameters with their intervals, sensors, and what to mind."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.errors import did_you_mean

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """What came out for a parameter; `low`, `high`: 95 % interval; `rig`: the rig's own value.

    `excited`: False where the log tells nothing of it; `value` is then the rig's.
    """

    name: str
    unit: str
    rig: float
    value: float
    error: float
    low: float
    high: float
    excited: bool


@dataclass(frozen=True)
class Sensor:
    """How a sensor agrees with the model: rms residual, the samples' own noise, both in `unit`.

    `explained`: 1 - residual variance over the variance of the samples; `worst`: the rms residual
    of the worst 100 samples, over the noise.
    """

    name: str
    unit: str
    samples: int
    residual: float
    noise: float
    explained: float
    worst: float


@dataclass(frozen=True)
class Fit:
    """A plant fitted to a log; `values` may go to `pcpc.simulate(rig, set=fit.values)`.

    `measured`, `predicted` (rows, sensors) at `t_s` (rows,); `correlation` (p, p) of the estimates;
    `notes`: what to mind, each a sentence; `missing`: what the log lacks, in words. `arrived`:
    whether the model leaves no more than noise; if not, `notes` begin with why, and no value is an
    estimate of the plant's.
    """

    rig: str
    log: str
    parameters: list[Parameter]
    sensors: list[Sensor]
    correlation: Array
    notes: list[str]
    t_s: Array
    measured: Array
    predicted: Array
    runs: int
    arrived: bool
    missing: Sequence[str] = ()

    @property
    def values(self) -> dict[str, float]:
        """The fitted values, BLOCK.NAME to number, of what the log tells."""
        return {one.name: one.value for one in self.parameters if one.excited}

    def __getitem__(self, name: str) -> Parameter:
        for one in self.parameters:
            if one.name == name:
                return one
        raise KeyError(f"{name}: not fitted{did_you_mean(name, [p.name for p in self.parameters])}")

    def json(self) -> dict[str, Any]:
        """Return all but the signals as what JSON holds; nothing for an infinite number."""

        def number(x: float) -> float | None:
            return float(x) if math.isfinite(x) else None

        return {
            "rig": self.rig, "log": self.log, "cycles": len(self.t_s), "runs": self.runs,
            "arrived": self.arrived,
            "parameters": [
                {key: number(v) if isinstance(v, float) else v for key, v in vars(one).items()}
                for one in self.parameters
            ],
            "correlation": [[number(x) for x in row] for row in self.correlation.tolist()],
            "sensors": [
                {key: number(v) if isinstance(v, float) else v for key, v in vars(one).items()}
                for one in self.sensors
            ],
            "notes": self.notes, "missing": list(self.missing),
        }  # fmt: skip

    def draw(self, path: str | Path) -> Path:
        """Write the overlay of model and log, and the residuals, as a picture; return `path`."""
        from pcpc.tools.study.fit import figure

        figure.draw(self, Path(path))
        return Path(path)
