"""`pcpc fit RIG LOG`: parameters of the plant from a log, as a table, a file and a picture."""

import argparse
import json
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.start.folder import folder_of
from pcpc.tools.study.fit.fitting import Model, fit, parse_range
from pcpc.tools.study.fit.result import VALUES
from pcpc.tools.terminal.ending import writing
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.progress import Progress


def command(options: argparse.Namespace) -> int:
    """Fit, write the folder, tell; NOT_MET where the model leaves more than noise.

    And where the log tells nothing of what was named, or nothing at all. LOSS if a part of it is
    missing.
    """
    need("a fit needs", "scipy.optimize", FIGURE)
    rig = load_rig(options.rig, None, options.set)
    model = Model(rig, [parse_range(option) for option in options.parameter], options.sensor)
    log = logs.read(Path(options.log))
    with folder_of(options.output, f"fit-{rig.config.rig}", empty=True) as folder:
        return _fit(options, model, log, folder)


def _fit(options: argparse.Namespace, model: Model, log: logs.Log, folder: Path) -> int:
    progress = Progress(options.quiet)
    found = fit(model, log, progress.show)
    progress.close()
    if options.json:
        print(json.dumps({**found.json(), "folder": str(folder)}))
    else:
        files = f"values   {VALUES}, for --set @FILE; fit.json; picture fit.png"
        print(f"{found.text()}{files}\nfolder   {folder}")
    with writing(folder):
        (folder / VALUES).write_text(found.settings(str(options.rig)), "utf-8")
        found.save(folder)
    named = {one.name for one in found.parameters if options.parameter and not one.excited}
    nothing = not any(one.excited for one in found.parameters)
    if named or nothing or not found.arrived:
        return Exit.NOT_MET
    return Exit.LOSS if found.missing else Exit.OK
