"""`pcpc.simulate`: a rig in virtual time, as a function."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.log.recorded import log_of
from pcpc.tools.after.place import finished, log_in, progress
from pcpc.tools.after.record import Run
from pcpc.tools.after.verdict.outcome import Outcome, changed
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
    """Run a rig in virtual time, in this process, and return what was recorded.

    The bits are those of `pcpc simulate` and of a lockstep run on a bus.

    rig         a rig file, or the name of one that comes with pcpc (`pcpc rigs`)
    controller  one of the rig's controllers; None: the one that it names
    set         other values of the rig, as --set: {"barrel.gap_rad": 0.003, "duration_s": 2}
    seed        of the rig's noises and random draws
    folder      keeps log and summary there; None: a temporary one, which goes with the run
    quiet       no progress; None: progress on a terminal only
    standby     other controllers of the rig; its `schedule` may hand over to them

    Raises pcpc.Error, one line with its place and cure, for a rig, setting or bus that cannot be,
    and for a log that cannot be written. A fault of the run is no error: see `Run.verdict`.
    """
    words, shown = settings(set, seed, standby), progress(quiet)
    loaded = load_rig(find(str(rig)), controller, words)
    outcome = Outcome("virtual", "memory", changed=changed(words))
    with log_in(folder, loaded) as (log, keep):
        simulation = Simulation(loaded, log, {}, outcome)
        try:
            simulation.to_end(shown)
        except KeyboardInterrupt:
            simulation.interrupt()
            raise
        return finished(log, loaded, outcome, keep)


def open(log: str | Path, *, trust: bool = False) -> Run:  # as `pcpc.open`
    """Return the run of a log file, a run folder, or `"latest"`.

    `trust`: also run the Python that stands in the log, see `pcpc replay --help`. pcpc.Error for
    what is no log.
    """
    run = Run(log_of(str(log)), trust=trust)
    run.log  # noqa: B018  read now: what is no log is said here
    return run
