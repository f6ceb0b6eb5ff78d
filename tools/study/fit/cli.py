"""`pcpc fit RIG LOG`: parameters of the plant from a log, as a table, a file and a picture."""

import argparse
import json
import math
import os
from collections.abc import Iterator
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.start.folder import folder_of
from pcpc.tools.study.fit.fitting import Model, asked, fit
from pcpc.tools.study.fit.result import Fit, Parameter
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.ending import writing
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.progress import Progress

VALUES, FACTS, PICTURE = "fit.yaml", "fit.json", "fit.png"


def command(options: argparse.Namespace) -> int:
    """Fit, write the folder, tell; NOT_MET where the model leaves more than noise.

    And where the log tells nothing of what was named. LOSS if a part of the log is missing.
    """
    need("a fit needs", "sweep", "scipy.optimize", FIGURE)
    rig = load_rig(options.rig, None, options.set)
    model = Model(rig, [asked(option) for option in options.parameter], options.sensor)
    log = logs.read(Path(options.log))
    _check_empty(options.output)
    with folder_of(options.output, f"fit-{rig.config.rig}") as folder:
        return _fitted(options, model, log, folder)


def _fitted(options: argparse.Namespace, model: Model, log: logs.Log, folder: Path) -> int:
    progress = Progress(options.quiet)
    found = fit(model, log, progress.show)
    progress.close()
    if options.json:
        print(json.dumps({**found.json(), "folder": str(folder)}))
    else:
        print("\n".join(told(found, folder)))
    with writing(folder):
        (folder / VALUES).write_text(values_text(found, str(options.rig)), "utf-8")
        (folder / FACTS).write_text(json.dumps(found.json(), indent=1) + "\n", "utf-8")
        found.draw(folder / PICTURE)
    named = {one.name for one in found.parameters if options.parameter and not one.excited}
    if named or not found.arrived:
        return Exit.NOT_MET
    return Exit.LOSS if found.missing else Exit.OK


def _check_empty(given: str | None) -> None:
    """Raise RigError where something is there already."""
    folder = Path(given or os.devnull)
    if given and folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise RigError(f"{folder}: is not empty; choose another folder with -o")


def values_text(found: Fit, rig: str) -> str:
    """Return the fitted values as a file for `--set @FILE`, each with its interval."""
    head = [f"{found.rig}, fitted to {found.log}", f"pcpc simulate {rig} --set @{VALUES}"]
    if not found.arrived:
        head.append(f"no estimate of the plant: {found.notes[0]}")
    lines = [line for text in head for line in screen.wrapped(text, "# ", "#   ")]
    for one in found.parameters:
        if one.excited:
            known = math.isfinite(one.error)
            about = f"95 %: {_interval(one, ' to ')}" if known else "no interval"
            lines += ["", f"# {about}; rig {one.rig:.9g}", f"{one.name}: {one.value!r}"]
    return "\n".join([*lines, *([] if found.values else ["{}"])]) + "\n"


def told(found: Fit, folder: Path) -> Iterator[str]:
    """Yield the lines of a fit, at most 80 columns."""
    cycles = f"{len(found.t_s):,} cycles, {len(found.sensors)} sensors"
    yield f"fit      {found.rig} to {cycles}, {found.runs:,} runs of the model"
    yield f"log      {found.log}"
    width = min(max(len(one.name) for one in found.parameters), 30)
    yield f"{'parameter':{width}} {'rig':>10} {'fitted':>11}   95 % interval"
    for one in found.parameters:
        yield from _row(one, width)
    yield f"{'sensor':{width}} {'left, rms':>10} {'own noise':>11}   explained"
    for sensor in found.sensors:
        share = f"{100.0 * sensor.explained:.4f} %" if math.isfinite(sensor.explained) else "-"
        unit = f" {sensor.unit}" if sensor.unit else ""
        row = f"{sensor.name:{width}} {sensor.residual:10.3g} {sensor.noise:11.3g}   {share}"
        yield f"{row}{unit}" if len(row + unit) <= 80 else row
    for label, notes in (("note", found.notes), ("missing", found.missing)):
        for note in notes:
            yield from screen.wrapped(note, f"{label:9}", " " * 9)
    yield f"values   {VALUES}, for --set @FILE; {FACTS}; picture {PICTURE}"
    yield f"folder   {folder}"


def _row(one: Parameter, width: int) -> Iterator[str]:
    name = one.name
    if len(name) > width:
        yield name
        name = ""
    if not one.excited:
        yield f"{name:{width}} {one.rig:10.5g} {'-':>11}   the log tells nothing of it"
        return
    digits = _digits(one)
    row = f"{name:{width}} {one.rig:10.5g} {one.value:11.{digits}g}   {_interval(one, ' .. ')}"
    yield row if len(row) <= 80 else row.removesuffix(f" {one.unit}")


def _interval(one: Parameter, to: str) -> str:
    if not math.isfinite(one.error):
        return "-"
    digits = _digits(one)
    return f"{one.low:.{digits}g}{to}{one.high:.{digits}g} {one.unit}".rstrip()


def _digits(one: Parameter) -> int:
    """Return how many digits tell the ends of the interval apart: two of its half width."""
    half = 0.5 * (one.high - one.low)
    if not (math.isfinite(half) and half > 0.0 and one.value != 0.0):
        return 6
    return min(max(2 + math.ceil(math.log10(abs(one.value) / half)), 3), 9)
