"""`pcpc.loop`: a controller in plain Python closes the loop, cycle by cycle."""

from collections.abc import Iterator, Mapping, MutableMapping
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.nodes.external import External
from pcpc.executive.nodes.watched import Work
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.place import finished_run, log_place, progress
from pcpc.tools.after.record import Run, UnknownName
from pcpc.tools.after.verdict.outcome import Outcome, changed_settings
from pcpc.tools.run.simulate import Simulation
from pcpc.tools.start.rigs import find
from pcpc.tools.start.settings import settings

Vector = NDArray[np.float64]


class NamedValues(MutableMapping[str, float]):
    """Values by name, as the loop has them; UnknownName, with a proposal, for another name."""

    def __init__(self, places: Mapping[str, int], values: Vector, writable: bool = False) -> None:
        self._places, self._values, self._writable = places, values, writable

    def _place(self, name: str) -> int:
        if name not in self._places:
            raise UnknownName(f"{name}: no such variable{did_you_mean(name, self._places)}")
        return self._places[name]

    def __getitem__(self, name: str) -> float:
        return float(self._values[self._place(name)])

    def __setitem__(self, name: str, value: float) -> None:
        place = self._place(name)
        if not self._writable:
            raise TypeError(f"{name}: only a sample's command can be set")
        self._values[place] = value

    def __delitem__(self, name: str) -> None:
        raise TypeError(f"{name}: stays")

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


class Sample(NamedValues):
    """A cycle of the executive that waits for your command; valid until the next one.

    sample["rx.FB_A.encoder"]            any variable of the executive
    sample.inputs["encoder_rad"]         the controller's inputs, as the rig wires them
    sample.command["motor_torque_Nm"]    set it; otherwise it keeps its value
    sample.t_s, sample.dt_s, sample.cycle

    UnknownName, with a proposal, for another name.
    """

    inputs: NamedValues
    command: NamedValues
    t_s = 0.0
    dt_s = 0.0

    @property
    def cycle(self) -> int:
        """The number of the cycle: t_s / dt_s."""
        return round(self.t_s / self.dt_s)


class Loop:
    """A rig in virtual time whose controller is the body of a `for`.

    An exception in the body, or `break`, ends the run and keeps its record in `run`. pcpc.Error:
    the rig has controllers on standby, or the loop has already run.
    """

    def __init__(
        self,
        rig: str | Path,
        controller: str | None,
        words: list[str],
        folder: str | Path | None,
        quiet: bool | None,
    ) -> None:
        self._progress, self._folder = progress(quiet), folder
        self._rig = load_rig(find(str(rig)), controller, words)
        self._outcome = Outcome(
            "virtual", "memory", changed=[*changed_settings(words), "controller=Python"]
        )
        if self._rig.config.standby:
            raise self._rig.error("standby", "nobody can take over from a controller in Python")
        spec = next(b for b in self._rig.nodes()["executive"].blocks if b.name == "controller")
        self._external = External(spec.block.step.declared, self._step)
        self._ports = [
            {name: i for i, name in enumerate(n for port in ports for n in port.names())}
            for ports in (spec.block.inputs, spec.block.outputs)
        ]
        self._sample: Sample | None = None
        self._samples: SimpleQueue[bool] = SimpleQueue()  # True: a sample waits; False: the end
        self._answers: SimpleQueue[None] = SimpleQueue()
        self._begun = self._over = False
        self._run: Run | None = None

    def __iter__(self) -> Iterator[Sample]:
        if self._begun:
            raise UserError("a loop runs once; make another one with pcpc.loop")
        self._begun = True
        with log_place(self._folder, self._rig) as (log, keep):
            try:
                yield from self._samples_into(log)
            finally:
                if log.is_file() and log.stat().st_size:
                    self._run = finished_run(log, self._rig, self._outcome, keep)

    def _samples_into(self, log: Path) -> Iterator[Sample]:
        """Run the rig in a thread, which waits for the command to each sample."""
        simulation = Simulation(self._rig, log, {}, self._outcome, self._external)
        node = simulation.run.blocks[0]
        names = [name for name, *_ in node.description["variables"]]
        self._sample = Sample({name: i for i, name in enumerate(names)}, node["v"])
        work = Work(lambda: simulation.to_end(self._progress), lambda: self._samples.put(False))
        work.start()
        ended = False
        try:
            while self._samples.get():
                yield self._sample
                self._answers.put(None)
            ended = True
        finally:
            self._over = True  # from here on the commands stay what they are
            if not ended:
                simulation.interrupt()
                self._answers.put(None)
            work.join()
        if work.error is not None:
            raise work.error

    @property
    def run(self) -> Run:
        """The record; pcpc.Error before the end."""
        if self._run is None:
            raise UserError("the loop has not ended: iterate over it first")
        return self._run

    def _step(self, t: float, dt: float, p: Vector, x: Vector, u: Vector, y: Vector) -> None:
        """Hand a sample to the `for` and wait for its command."""
        sample = self._sample
        if self._over or sample is None:
            return
        sample.t_s, sample.dt_s = t, dt
        sample.inputs, sample.command = (
            NamedValues(self._ports[0], u),
            NamedValues(self._ports[1], y, True),
        )
        self._samples.put(True)
        self._answers.get()


def loop(
    rig: str | Path,
    controller: str | None = None,
    *,
    set: Mapping[str, Any] | None = None,
    seed: int | None = None,
    folder: str | Path | None = None,
    quiet: bool | None = None,
) -> Loop:
    """Close a rig's loop with a controller in plain Python, in virtual time.

        loop = pcpc.loop("hull")
        for sample in loop:
            error = sample.inputs["q_d_rad"] - sample.inputs["encoder_rad"]
            sample.command["motor_torque_Nm"] = 2.0 * error
        loop.run.metrics

    The ports are those of `controller`, one of the rig's, whose law is not used. All else is as in
    `pcpc.simulate`: one sample of delay, the codec's rounding, limits, losses. The same program
    gives the same bits, and `loop.run.replay()` recomputes all but the commands. It takes some 20
    us a cycle, plus your own code. The rig's limits are not judged. Raises pcpc.Error as
    `pcpc.simulate`.
    """
    return Loop(rig, controller, settings(set, seed), folder, quiet)
