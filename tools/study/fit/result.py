"""What came of a fit: parameters with their intervals, sensors, and what to mind."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta, Struct

from pcpc.executive.errors import did_you_mean
from pcpc.tools.study.arrays import Array
from pcpc.tools.study.result import Result
from pcpc.tools.terminal.answer import Count
from pcpc.tools.terminal.screen import wrapped_lines

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VALUES = "fit.yaml"
_SIGNALS = ("t_s", "measured", "predicted")


@dataclass(frozen=True)
class Parameter:
    """What came out for a parameter; `low`, `high`: 95 % interval; `rig`: the rig's own value.

    `excited`: False where the log does not determine it; `value` is then the rig's.
    """

    name: str
    "BLOCK.NAME"
    unit: str
    "empty: none"
    rig: float
    "the rig's own value, in unit"
    value: float
    "in unit; the rig's where it is not excited"
    error: float
    "standard error, in unit; null: no interval"
    low: float
    "of the 95 % interval, in unit"
    high: float
    "of the 95 % interval, in unit"
    excited: bool
    "false: the log tells nothing of it"

    @property
    def known(self) -> bool:
        """Whether it has an interval."""
        return math.isfinite(self.error)

    @property
    def digits(self) -> int:
        """How many digits tell the ends of the interval apart: two of its half width."""
        half = 0.5 * (self.high - self.low)
        if not (math.isfinite(half) and half > 0.0 and self.value != 0.0):
            return 6
        return min(max(2 + math.ceil(math.log10(abs(self.value) / half)), 3), 9)

    def interval(self, to: str) -> str:
        """Return its interval in words, with its unit."""
        ends = f"{self.low:.{self.digits}g}{to}{self.high:.{self.digits}g} {self.unit}"
        return ends.rstrip() if self.known else "-"

    def lines(self, width: int) -> Iterator[str]:
        """Yield its row of the table."""
        name = self.name
        if len(name) > width:
            yield name
            name = ""
        if not self.excited:
            yield f"{name:{width}} {self.rig:10.5g} {'-':>11}   the log does not determine it"
            return
        row = f"{name:{width}} {self.rig:10.5g} {self.value:11.{self.digits}g}"
        yield f"{row}   {self.interval(' .. ')}"


@dataclass(frozen=True)
class Sensor:
    """How a sensor agrees with the model: rms residual, the samples' own noise, both in `unit`.

    `explained`: 1 - residual variance over the variance of the samples; `worst`: the rms residual
    of the worst 100 samples, over the noise.
    """

    name: str
    unit: str
    "empty: none"
    samples: Count
    residual: float
    "rms, in unit"
    noise: float
    "of the samples alone, rms, in unit"
    explained: float
    "share of the variance"
    worst: float
    "rms residual of the worst 100 samples, over the noise"


class Facts(Struct):
    """All of a fit but its signals; null: not finite."""

    rig: str
    log: str
    parameters: Annotated[list[Parameter], Meta(min_length=1)]
    sensors: list[Sensor]
    correlation: list[list[float]]
    "of the estimates, a row a parameter"
    notes: list[str]
    "what to mind; where arrived is false the first one is why"
    runs: Count
    "of the model"
    arrived: bool
    "the model leaves no more than noise; if not, no value is an estimate"
    missing: list[str]
    "gaps of the log, in words"
    cycles: Count
    "of the log"


class FactsInFolder(Facts):
    """What `--json` prints; null: not finite."""

    folder: str
    "with fit.yaml, fit.json, fit.png"


@dataclass(frozen=True)
class Fit(Result):
    """A plant fitted to a log; `values` may go to `pcpc.simulate(rig, set=fit.values)`.

    `fit[NAME]`: a parameter, KeyError for another name. `measured`, `predicted`: (rows, sensors) at
    `t_s` (rows,); `correlation`: (p, p) of the estimates; `notes`: warnings;
    `missing`: gaps of the log, in words. `arrived`: whether the model leaves no more than noise; if
    not, `notes` begin with the reason and no value is an estimate of the plant's.
    """

    name = "fit"

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
        """The fitted values by BLOCK.NAME, without those that the log does not determine."""
        return {one.name: one.value for one in self.parameters if one.excited}

    def __getitem__(self, name: str) -> Parameter:
        for one in self.parameters:
            if one.name == name:
                return one
        raise KeyError(f"{name}: not fitted{did_you_mean(name, [p.name for p in self.parameters])}")

    def facts(self) -> Facts:
        """Return all but the signals."""
        found = {key: value for key, value in vars(self).items() if key not in _SIGNALS}
        return Facts(**found, cycles=len(self.t_s))

    def lines(self) -> Iterator[str]:
        """Yield the tables of parameters and sensors, and what to mind."""
        cycles = f"{len(self.t_s):,} cycles, {len(self.sensors)} sensors"
        yield f"fit      {self.rig} to {cycles}, {self.runs:,} runs of the model"
        yield f"log      {self.log}"
        width = min(max(len(one.name) for one in self.parameters), 30)
        yield f"{'parameter':{width}} {'rig':>10} {'fitted':>11}   95 % interval"
        for parameter in self.parameters:
            yield from parameter.lines(width)
        yield f"{'sensor':{width}} {'left, rms':>10} {'own noise':>11}   explained"
        for sensor in self.sensors:
            share = f"{100.0 * sensor.explained:.4f} %" if math.isfinite(sensor.explained) else "-"
            row = f"{sensor.name:{width}} {sensor.residual:10.3g} {sensor.noise:11.3g}   {share}"
            yield f"{row} {sensor.unit}"
        for label, notes in (("note", self.notes), ("missing", self.missing)):
            yield from (f"{label:9}{note}" for note in notes)

    def settings(self, rig: str) -> str:
        """Return the fitted values as a file for `--set @FILE`, each with its interval."""
        head = [f"{self.rig}, fitted to {self.log}", f"pcpc simulate {rig} --set @{VALUES}"]
        if not self.arrived:
            head.append(f"no estimate of the plant: {self.notes[0]}")
        lines = [line for text in head for line in wrapped_lines(text, "# ", "#   ")]
        for one in self.parameters:
            if one.excited:
                about = f"95 %: {one.interval(' to ')}" if one.known else "no interval"
                lines += ["", f"# {about}; rig {one.rig:.9g}", f"{one.name}: {one.value!r}"]
        return "\n".join([*lines, *([] if self.values else ["{}"])]) + "\n"

    def pictures(self) -> Mapping[str, "Figure"]:
        """Return the overlay of model and log, and the residuals."""
        from pcpc.tools.study.fit import figure  # time

        return {"fit": figure.overlay(self)}

    def draw(self, path: str | Path) -> Path:
        """Write the overlay of model and log, and the residuals, as a picture; return `path`."""
        self.pictures()["fit"].savefig(path)
        return Path(path)
