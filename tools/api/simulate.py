"""`pcpc.simulate`: a rig in virtual time, as a function."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.log.recorded import log_of
from pcpc.tools.after.place import finished_run, log_place, progress
from pcpc.tools.after.record import Run
from pcpc.tools.after.verdict.outcome import Outcome, changed_settings
from pcpc.tools.run.simulate import Simulation
from pcpc.tools.start.rigs import find
from pcpc.tools.start.settings import settings


def simulate(
    rig: str | Path,
    controller: str | None = None,
    *,
    set: Mapping[str, Any] | None = None,
    seed: int | None = None,
    folder: str | Path | None = None,
    quiet: bool | None = None,
    standby: Sequence[str] = (),
) -> Run:
    """Run a rig in virtual time, in this process, and return the recorded run.

    It is bit-identical to `pcpc simulate` and to a lockstep run on a bus.

    rig         a rig's name (`pcpc rigs`) or file
    controller  one of the rig's controllers; None: the rig's default
    set         other values of the rig, as --set: {"barrel.gap_rad": 0.003, "duration_s": 2}
    seed        of the rig's noise and random draws
    folder      keeps log and summary there; None: a temporary folder, deleted with the run
    quiet       no progress; None: progress on a terminal only
    standby     other controllers of the rig, for its `schedule` of handovers

    Raises pcpc.Error, one line with place and cure: a wrong rig, setting or bus, or a log that
    cannot be written. A fault of the run raises nothing: see `Run.verdict`.
    """
    words, shown = settings(set, seed, standby), progress(quiet)
    loaded = load_rig(find(str(rig)), controller, words)
    outcome = Outcome("virtual", "memory", changed=changed_settings(words))
    with log_place(folder, loaded) as (log, keep):
        simulation = Simulation(loaded, log, {}, outcome)
        try:
            simulation.to_end(shown)
        except KeyboardInterrupt:
            simulation.interrupt()
            raise
        return finished_run(log, loaded, outcome, keep)


def open(log: str | Path, *, trust: bool = False) -> Run:  # as `pcpc.open`
    """Return the run of a log file, a run folder, or `"latest"`.

    `trust`: also run the Python in the log, see `pcpc replay --help`. Raises pcpc.Error: no
    such log, or not a log.
    """
    run = Run(log_of(str(log)), trust=trust)
    run.log  # noqa: B018  read now: what is no log is said here
    return run
