"""The plant of a rig alone, driven by recorded commands: WIDTH settings at once, or one.

    rows      one a period: first what the plant's node received in it, then its blocks step
    signals   what the node would send, before the codec rounds; see `Driven.signals`

Nothing is sent and nobody supervises: what was received is given, so that a plant with the settings
and the noise of the recorded run gives its bits. Settings that part the lanes are done one by one.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.jit import LOOP_INTERPRETED, OPTIONS, inline, njit
from pcpc.drivers.compiled.lanes import WIDTH, Lane, LanesDiffer, table
from pcpc.drivers.compiled.records import Cells
from pcpc.drivers.compiled.stage import Stage
from pcpc.drivers.compiled.views import lane_rows
from pcpc.executive.batch import cycle
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.layout import Loop
from pcpc.executive.nodes.install import install_in_memory
from pcpc.executive.nodes.plan import describe, plan
from pcpc.executive.nodes.watched import StepError, watched_result
from pcpc.executive.own_laws.preparation import prepared_values
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.executive.rig.reading import Rig

_OPTIONS = OPTIONS | {"_nrt": False}
Array = NDArray[np.float64]


@inline
def _rows(
    n: Loop,
    w: Cells[Lane],
    values: Array,
    width: int,
    steps: Cells[int],
    places: Cells[int],
    commands: Array,
    wanted: Cells[int],
    trace: Cells[Lane],
    first: int,
) -> None:
    """Do the rows of `commands` from cycle `first` on, `width` runs at once."""
    for row in range(commands.shape[0]):
        n.control.passes += 1  # for `watched`
        for i in range(places.shape[0]):
            w[places[i]] = commands[row, i]
        cycle.step(n, w, values, width, steps, first + row)
        cycle.carry(n, w, sh.MAX_BLOCKS)
        for i in range(wanted.shape[0]):
            trace[row * wanted.shape[0] + i] = w[wanted[i]]


@njit(**_OPTIONS)
def _in_lanes(
    n: Loop,
    values: Array,
    steps: Cells[int],
    places: Cells[int],
    commands: Array,
    wanted: Cells[int],
    trace: Array,
    first: int,
) -> None:
    """Do the rows in all lanes: `values` and `trace` a LANE each."""
    w, lane_trace = lane_rows(values), lane_rows(trace)
    _rows(n, w, values, WIDTH, steps, places, commands, wanted, lane_trace, first)


@njit(**_OPTIONS)
def _alone(
    n: Loop,
    values: Array,
    steps: Cells[int],
    places: Cells[int],
    commands: Array,
    wanted: Cells[int],
    trace: Array,
    first: int,
) -> None:
    """Do the same for one: `values` (rows,), `trace` (rows * wanted,)."""
    _rows(n, values, values, 1, steps, places, commands, wanted, trace, first)


class DrivenPlant:
    """The plant of a rig, laid out once; for one thread.

    `received`, `sent`: the names of its signals, "FRAME.signal", in the order of the columns;
    `sources`: what of them is wired to what; `every`: cycles from one sample to the next; `quantum`
    of the bus, 0 for none.
    """

    def __init__(self, rig: Rig) -> None:
        """Raise RigError for a plant that is not pcpc's to step, or has no compiled step."""
        if rig.config.plant.drive is not None:
            what = "the drive moves this plant, not a frame; take the rig without it"
            raise rig.error("plant.drive", what)
        made = plan(rig, "plant", "lockstep")
        for spec in made.spec.blocks:
            if LOOP_INTERPRETED or spec.is_opaque or not isinstance(spec.block.step, Stage):
                raise RigError(f"{spec.where()}: {spec.name} has no compiled step to be fitted")
        self.rig, self._made = rig, made
        self._block = sh.private(describe(made, {}))
        install_in_memory(made, self._block.loop)
        index = made.table.index
        self.received = [f"{f.name}.{s.name}" for f in made.rx_frames for s in f.signals]
        self._places = np.array([index[f"rx.{name}"] for name in self.received], np.int64)
        self.sources = dict(made.spec.transmit)
        self.sent = [f"{f.name}.{s.name}" for f in made.tx_frames for s in f.signals]
        self.every = {
            f"{f.name}.{s.name}": f.every_n(rig.config.rate_hz)
            for f in made.tx_frames
            for s in f.signals
        }
        signals = {
            f"{f.name}.{s.name}": s for f in (*made.rx_frames, *made.tx_frames) for s in f.signals
        }
        self.quantum = {k: 0.0 if s.is_float else abs(s.factor) for k, s in signals.items()}
        self._offset = {k: s.offset for k, s in signals.items()}
        self._index = index
        self._specs = {spec.name: spec for spec in made.spec.blocks}
        self._single = np.array([spec.block.step.entry for spec in made.spec.blocks], np.int64)
        self._differ = False

    @property
    def settings(self) -> dict[str, float]:
        """The settings of the plant's blocks, as BLOCK.NAME."""
        return {
            f"{spec.name}.{k}": v for spec in self._specs.values() for k, v in spec.settings.items()
        }

    def port(self, name: str) -> Any:
        """Return the port of a setting BLOCK.NAME. RigError for none, with a proposal."""
        block, _, setting = name.partition(".")
        spec = self._specs.get(block)
        ports = {} if spec is None else {n: p for p in spec.block.settings for n in p.names()}
        if setting not in ports:
            cure = did_you_mean(name, self.settings)
            raise RigError(f"{name}: the plant has no such setting{cure}")
        return ports[setting]

    def signals(
        self,
        points: Sequence[Mapping[str, float]],
        names: Sequence[str],
        commands: Array,
        first: int = 0,
        seed: int = 1,
    ) -> Array:
        """Return the signals (points, rows, names) under the `commands` (rows, received).

        `points`: settings BLOCK.NAME beside the rig's; `names`: FRAME.signal of what is sent, or
        BLOCK.PORT; `first`: the cycle of the first row; `seed`: of the noises. RigError for
        settings that the plant refuses, StepError for a step that raises.
        """
        wanted = np.array([self.place(name) for name in names], np.int64)
        signals = np.empty((len(points), len(commands), len(names)))
        commands = np.ascontiguousarray(commands)
        for start in range(0, len(points), WIDTH):
            some = points[start : start + WIDTH]
            columns = [self._values(point, seed) for point in some]
            batch = (
                None
                if self._differ or len(some) == 1
                else self._lanes(columns, wanted, commands, first)
            )
            if batch is None:
                batch = np.stack([self._one(c, wanted, commands, first) for c in columns])
            signals[start : start + len(some)] = batch
        return signals

    @property
    def blocks(self) -> list[str]:
        """The names of the plant's blocks."""
        return list(self._specs)

    def unit(self, name: str) -> str:
        """Return the unit of a signal."""
        return self._made.table.variables[self.place(name)].unit

    def rounded(self, name: str, values: Array) -> Array:
        """Return values (n,) of FRAME.signal as the bus rounds them; of other names as they are."""
        quantum, offset = self.quantum.get(name, 0.0), self._offset.get(name, 0.0)
        if not quantum:
            return values
        return np.asarray(np.rint((values - offset) / quantum) * quantum + offset)

    def place(self, name: str) -> int:
        """Return where a signal, or BLOCK.PORT, stands. RigError for none, with a proposal."""
        place = self._index.get(f"tx.{name}", self._index.get(name))
        if place is None:
            raise RigError(f"{name}: the plant has no such signal{did_you_mean(name, self.sent)}")
        return int(place)

    def _values(self, point: Mapping[str, float], seed: int) -> Array:
        values = np.array(self._block.loop.v[: self._block.loop.n_variables])
        changed: dict[str, dict[str, float]] = {name: {} for name in self._specs}
        for name, value in point.items():
            self.port(name)
            block, _, setting = name.partition(".")
            changed[block][setting] = value
        for name, own in changed.items():
            spec: BlockSpec = replace(
                self._specs[name], settings={**self._specs[name].settings, **own}
            )
            try:
                pairs = prepared_values(spec.block, spec.settings, self.rig.config.rate_hz, seed)
            except ValueError as error:
                raise RigError(f"{name}: {error}") from None
            for key, value in (*pairs[0], *pairs[1]):
                values[self._index[f"{name}.{key}"]] = value
        return values

    def _lanes(
        self, columns: Sequence[Array], wanted: NDArray[np.int64], commands: Array, first: int
    ) -> Array | None:
        """Return the signals of at most WIDTH columns; None where lanes cannot."""
        try:
            steps = _entries(tuple(spec.block.step for spec in self._specs.values()))
        except Exception:  # numba has many for a step that lanes cannot take
            self._differ = True
            return None
        loop = self._block.loop
        values = table(cycle.rows_of(loop))
        padded = [*columns, *[columns[0]] * (WIDTH - len(columns))]
        values[: len(columns[0])] = np.stack(padded, axis=1)
        trace = table(len(commands) * len(wanted))
        arguments = loop, values, steps, self._places, commands, wanted, trace, first
        try:
            self._call_watched(lambda: _in_lanes(*arguments))
        except LanesDiffer:
            self._differ = True
            return None
        shaped = trace.reshape(len(commands), len(wanted), WIDTH)
        return np.ascontiguousarray(shaped.transpose(2, 0, 1)[: len(columns)])

    def _one(self, values: Array, wanted: NDArray[np.int64], commands: Array, first: int) -> Array:
        trace, loop = np.zeros(len(commands) * len(wanted)), self._block.loop
        arguments = loop, values, self._single, self._places, commands, wanted, trace, first
        self._call_watched(lambda: _alone(*arguments))
        return trace.reshape(len(commands), len(wanted))

    def _call_watched(self, do: Callable[[], object]) -> None:
        try:
            watched_result(do, [self._block.loop])
        except StepError:
            names = list(self._specs)
            at = int(self._block.loop.control.stepping) - 1
            raise StepError(f"the step of {names[at]} does not return") from None


@lru_cache(maxsize=8)
def _entries(steps: tuple[Stage, ...]) -> NDArray[np.int64]:
    return np.array([step.entry_of_lanes for step in steps], np.int64)
