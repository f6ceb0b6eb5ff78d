"""A plant fitted to a log: which parameters, against which sensors, and what came of it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcpc.executive.batch.driven import DrivenPlant
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.log.reader import Log
from pcpc.executive.rig.reading import Rig
from pcpc.plants.identification import Identification, identification_of
from pcpc.plants.judging import effective_rig
from pcpc.tools.study.arrays import Array
from pcpc.tools.study.fit.estimate import Estimate, close_pairs, estimate
from pcpc.tools.study.fit.noise import HOLDS
from pcpc.tools.study.fit.record import MeasuredRun, record_of
from pcpc.tools.study.fit.result import Fit, Parameter, Sensor

NARROW = 1e-6  # a standard error below this share of the value
FEW = 0.2  # a 95 % interval wider than this share of the value to either side is worth a word


@dataclass(frozen=True)
class Range:
    """A parameter to be fitted, BLOCK.NAME, and its bounds, or None for the port's."""

    name: str
    low: float | None = None
    high: float | None = None


def parse_range(option: str) -> Range:
    """Return what `NAME` or `NAME=lo:hi` says. RigError."""
    name, equals, text = (part.strip() for part in option.partition("="))
    if not equals:
        return Range(name)
    try:
        low, high = (float(word) for word in text.split(":"))
    except ValueError:
        raise RigError(f"--parameter {option}: expected NAME, or NAME=lo:hi") from None
    if not low < high:
        raise RigError(f"--parameter {option}: write the lower bound first")
    return Range(name, low, high)


class Model:
    """A rig's plant as a model: parameters, sensors, and how they hang together."""

    def __init__(
        self, rig: Rig, parameters: Sequence[Range] = (), sensors: Sequence[str] = ()
    ) -> None:
        """Raise RigError for names that are not the plant's."""
        self.rig, self.plant = rig, DrivenPlant(rig)
        self.identification: Identification = identification_of(rig)
        self.own = self.plant.settings
        self.parameters = list(parameters) or [Range(name) for name in self._default_names()]
        if not self.parameters:
            raise RigError(f"{rig.path}: nothing to be fitted; name it with --parameter")
        twice = {one.name for one in self.parameters}
        if len(twice) < len(self.parameters):
            raise RigError("--parameter: a name is there twice; give each once")
        bounds = [self._bounds(one) for one in self.parameters]
        self.bounds = np.array(bounds, float)
        self.start = np.array([self.own[one.name] for one in self.parameters])
        self.start = np.clip(self.start, self.bounds[:, 0], self.bounds[:, 1])
        self.sensors = self._sensors(sensors)
        self.fixed = self._fixed_values()

    @property
    def names(self) -> list[str]:
        """The names of the parameters."""
        return [one.name for one in self.parameters]

    @property
    def quantum(self) -> Array:
        """The steps by which the bus rounds the sensors, (sensors,), 0 for none."""
        return np.array([self.plant.quantum.get(name, 0.0) for name in self.sensors])

    def predicted(self, points: Array, given: Array, first: int = 0, seed: int = 1) -> Array:
        """Return the model's sensors (m, rows, sensors) for points (m, p)."""
        settings = [self._settings(point) for point in points]
        return self.plant.signals(settings, list(self.sensors.values()), given, first, seed)

    def samples(self, point: Array, given: Array, first: int = 0) -> tuple[Array, Array]:
        """Return the model's sensors at one point, and its samples (rows, sensors) of them.

        Samples are what it sends without noise, rounded as its sensors and the bus round.
        """
        sent = [name if name in self.plant.sent else port for name, port in self.sensors.items()]
        names = [*self.sensors.values(), *sent]
        both = self.plant.signals([self._settings(point)], names, given, first)[0]
        smooth, raw = both[:, : len(sent)], both[:, len(sent) :]
        columns = [self.plant.rounded(name, c) for name, c in zip(sent, raw.T, strict=True)]
        return smooth, np.stack(columns, axis=1)

    def _settings(self, point: Array) -> dict[str, float]:
        return self.fixed | dict(zip(self.names, point.tolist(), strict=True))

    def _default_names(self) -> list[str]:
        if self.identification.parameters is not None:
            return list(self.identification.parameters)
        return [
            name
            for name, value in self.own.items()
            if value != 0.0 and "noise" not in name and self.plant.port(name).unit
        ]

    def _bounds(self, one: Range) -> tuple[float, float]:
        port, own = self.plant.port(one.name), self.own[one.name]
        low = port.low if one.low is None else one.low
        high = port.high if one.high is None else one.high
        if one.low is not None and not port.low <= one.low < high <= port.high:
            what = f"{one.low:g}:{high:g} is not within {port.low:g}..{port.high:g} {port.unit}"
            raise RigError(f"--parameter {one.name}: {what.rstrip()}")
        if one.low is None and own == 0.0:
            what = "the rig's value is 0, so its size is unknown; give NAME=lo:hi"
            raise RigError(f"--parameter {one.name}: {what}")
        return low, high

    def _sensors(self, given: Sequence[str]) -> dict[str, str]:
        """Return what is compared: a name in the log to a name of the model."""
        sends = {
            name: source
            for name, source in self.plant.sources.items()
            if source.partition(".")[0] in self.plant.blocks
        }
        said = (
            dict(self.identification.sensors) if self.identification.sensors is not None else sends
        )
        for name in said:
            if name not in self.plant.sent:
                raise RigError(
                    f"SENSORS: {name}: the plant sends no such signal"
                    + did_you_mean(name, self.plant.sent)
                )
        chosen = {name: said.get(name, sends.get(name, name)) for name in given} or said
        if not chosen:
            raise RigError(f"{self.rig.path}: the plant sends nothing to fit to; give --sensor")
        for name in chosen.values():
            self.plant.place(name)
        return chosen

    def _fixed_values(self) -> dict[str, float]:
        fixed = {name: 0.0 for name, value in self.own.items() if "noise" in name and value != 0.0}
        fixed |= {name: float(value) for name, value in (self.identification.model or {}).items()}
        for name in fixed:
            self.plant.port(name)
        return {name: value for name, value in fixed.items() if name not in self.names}


def fit(model: Model, log: Log, say: Callable[[str], None] = lambda _: None) -> Fit:
    """Fit `model` to `log`. RigError for a log that is not of its plant, or too short."""
    record = record_of(log, model.plant, list(model.sensors))
    notes = _log_notes(model, record, log)
    found = estimate_of(model, record, say)
    parameters = [_parameter(model, found, i) for i in range(len(model.names))]
    sensors = [_sensor(model, record, found, j) for j in range(len(model.sensors))]
    notes = [*_refusal(found, record, sensors), *notes, *_warnings(model, found, parameters)]
    return Fit(
        model.rig.config.rig,
        str(log.path),
        parameters,
        sensors,
        found.correlation,
        notes,
        record.t_s,
        record.measured,
        found.predicted,
        found.evaluations,
        found.arrived,
        log.missing,
    )


def estimate_of(
    model: Model, record: MeasuredRun, say: Callable[[str], None] = lambda _: None
) -> Estimate:
    """Return the estimate of the model's parameters, in the order of their names."""

    def predict(points: Array, rows: int) -> Array:
        return model.predicted(points, record.given[:rows], record.first)

    def samples(point: Array) -> tuple[Array, Array]:
        return model.samples(point, record.given, record.first)

    return estimate(
        predict, record.measured, model.quantum, model.start, model.bounds, samples, say
    )


def _parameter(model: Model, found: Estimate, i: int) -> Parameter:
    name = model.names[i]
    low, high = (float(end) for end in found.interval[i])
    unit, value, error = model.plant.port(name).unit, float(found.values[i]), float(found.errors[i])
    excited = bool(found.excited[i])
    if not (found.arrived or found.alike):
        low, high, error = -math.inf, math.inf, math.inf
    return Parameter(name, unit, model.own[name], value, error, low, high, excited)


def _sensor(model: Model, record: MeasuredRun, found: Estimate, j: int) -> Sensor:
    name = list(model.sensors)[j]
    samples = record.measured[:, j]
    there = np.isfinite(samples)
    residual = (found.predicted[:, j] - samples)[there]
    spread = float(np.var(samples[there])) if there.any() else 0.0
    power = float(np.mean(residual**2)) if there.any() else math.nan
    explained = max(1.0 - power / spread, 0.0) if spread > 0.0 else math.nan
    return Sensor(
        name,
        model.plant.unit(model.sensors[name]),
        int(there.sum()),
        math.sqrt(power),
        float(found.own[j]),
        explained,
        float(found.worst[j]),
    )


def _log_notes(model: Model, record: MeasuredRun, log: Log) -> list[str]:
    """Return what is to be said before a fit."""
    own = {
        name: value
        for name, value in _settings(effective_rig(log)).items()
        if name in model.own and name not in model.names
    }
    other = [
        f"{name} = {value:g} (here {model.own[name]:g})"
        for name, value in own.items()
        if value != model.own[name]
    ]
    notes = [f"the log's rig has {', '.join(other)}"] if other else []
    two = model.predicted(model.start[None], record.given[:200], record.first, seed=2)
    one = model.predicted(model.start[None], record.given[:200], record.first, seed=1)
    if not np.array_equal(one, two, equal_nan=True):
        notes.append(
            "the model draws noise, which it should not: name it in MODEL of identification.py"
        )
    return notes


def _settings(rig: Mapping[str, Any]) -> dict[str, float]:
    blocks = rig.get("plant", {}).get("blocks", {})
    return {
        f"{block}.{name}": value
        for block, about in blocks.items()
        for name, value in about.get("parameters", {}).items()
    }


def narrow(parameters: Sequence[Parameter]) -> list[str]:
    """Return a note where standard errors are too small to be believed."""
    found = [one.name for one in parameters if one.excited and one.error < NARROW * abs(one.value)]
    what = "this log is so sensitive that the search may have missed the best value, by more"
    return [f"{', '.join(found)}: {what} than the interval shows"] if found else []


def _refusal(found: Estimate, record: MeasuredRun, sensors: Sequence[Sensor]) -> list[str]:
    """Return why the end is no estimate of the plant; nothing where it explains the record."""
    if found.arrived:
        return []
    if not found.smooth:
        return [
            "the search did not converge: this record is so sensitive that nobody can say how far "
            "its end is from the best value; take a calmer record"
        ]
    worst = sorted((s for s in sensors if s.worst > HOLDS), key=lambda s: -s.worst)[:3]
    left = ", ".join(f"{s.name} {s.worst:.3g} times" for s in worst)
    begin, end = (found.explained * record.period_s, found.rows * record.period_s)
    what = (
        f"the residuals exceed the samples' own noise: {left} (a right model: up to "
        f"{HOLDS:g}); it explains the first {begin:.3g} s of {end:.3g} s"
    )
    if found.alike:
        return [
            f"{what}. Searches from several starts end there, so the model is probably wrong, not "
            "the search lost; the intervals hold only for a right model"
        ]
    return [
        f"the search did not converge: {what}. The search is lost or the model is wrong: start "
        "closer with --set, fit fewer values, or take a calmer record"
    ]


def _warnings(model: Model, found: Estimate, parameters: Sequence[Parameter]) -> list[str]:
    notes = []
    for one, bounds in zip(parameters, model.bounds, strict=True):
        told = (model.identification.parameters or {}).get(one.name, "")
        cure = f"; that needs {told}" if told else "; that needs a run that moves what it acts on"
        if not one.excited:
            notes.append(f"{one.name}: this log does not determine it; the rig's value stays{cure}")
        elif math.inf > one.high - one.value > FEW * abs(one.value):
            notes.append(f"{one.name}: this log hardly determines it{cure}")
        if one.excited and min(abs(one.value - b) for b in bounds) <= 1e-6 * abs(one.rig or 1.0):
            notes.append(f"{one.name}: it ended at its bound {one.value:g}")
    if 0 < found.smooth < found.rows:
        share = 100.0 * found.smooth / found.rows
        notes.append(
            "the whole record is so sensitive that the search may have ended beside the "
            f"best value; the intervals are those of its first {share:.0f} %"
        )
    notes += narrow(parameters)
    for a, b, c in close_pairs(found.correlation, model.names):
        notes.append(
            f"{a} and {b}: correlation {c:+.3f}; this log knows one combination of "
            "them better than each"
        )
    return notes
