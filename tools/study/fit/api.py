"""`pcpc.fit`: parameters of a plant from a log, as an object."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.log.recorded import log_of
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.place import progress
from pcpc.tools.after.record import Run
from pcpc.tools.start.rigs import find
from pcpc.tools.start.settings import settings
from pcpc.tools.study.fit.fitting import Model, Range
from pcpc.tools.study.fit.fitting import fit as fit_model
from pcpc.tools.study.fit.result import Fit


def fit(
    rig: str | Path,
    log: str | Path | Run,
    parameters: Sequence[str] | Mapping[str, tuple[float, float] | None] = (),
    *,
    sensors: Sequence[str] = (),
    set: Mapping[str, Any] | None = None,
    quiet: bool | None = None,
) -> Fit:
    """Estimate parameters of a rig's plant from the commands and sensors in a log.

        found = pcpc.fit("slew10", run, ["barrel.coulomb_Nm", "barrel.gap_rad"])
        found["barrel.gap_rad"].value, .low, .high       with the 95 % interval
        found.values                                     for pcpc.simulate(rig, set=found.values)
        found.correlation, found.sensors, found.notes, found.draw("fit.png")

    rig         the rig whose plant is the model; its values are the start
    log         a Run, a log file, a run folder, or "latest"
    parameters  BLOCK.NAME of settings of the plant, or {name: (low, high)}; (): those of
                identification.py, or all that have a unit and are not 0
    sensors     FRAME.signal from the bus, or BLOCK.PORT of the plant's record; (): those of
                identification.py, or all that the plant sends
    set         other values of the rig, as in `pcpc.simulate`

    The recorded commands drive the model. The fit minimises the simulation error, each sensor in
    units of its noise (docs/howto/fit.md). Raises pcpc.Error: the log is of another plant or too
    short, or a name is not the plant's.
    """
    loaded = load_rig(find(str(rig)), None, settings(set))
    bounds = parameters if isinstance(parameters, Mapping) else dict.fromkeys(parameters)
    asked = [Range(name, *(ends or (None, None))) for name, ends in bounds.items()]
    shown = progress(quiet)
    read = log.log if isinstance(log, Run) else Opened(log_of(str(log))).log
    found = fit_model(Model(loaded, asked, sensors), read, shown.show)
    shown.close()
    return found
