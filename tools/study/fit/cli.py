"""`pcpc fit RIG LOG`: parameters of the plant from a log, as a table, a file and a picture."""

from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.opened import Opened
from pcpc.tools.start.folder import folder_of
from pcpc.tools.study.fit.commands import FitRequest
from pcpc.tools.study.fit.fitting import Model, fit, parse_range
from pcpc.tools.study.fit.result import VALUES, FactsInFolder
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.ending import writing
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.progress import Progress


def command(request: FitRequest) -> int:
    """Fit, write the folder, tell; NOT_MET where the model leaves more than noise.

    And where the log tells nothing of what was named, or nothing at all. LOSS if a part of it is
    missing.
    """
    need("a fit needs", "scipy.optimize", FIGURE)
    rig = load_rig(request.rig, None, request.set)
    model = Model(rig, [parse_range(text) for text in request.parameter], request.sensor)
    log = Opened(Path(request.log)).log
    with folder_of(request.output, f"fit-{rig.config.rig}", empty=True) as folder:
        return _fit(request, model, log, folder)


def _fit(request: FitRequest, model: Model, log: logs.Log, folder: Path) -> int:
    progress = Progress(request.quiet)
    found = fit(model, log, progress.show)
    progress.close()
    if request.json:
        print(screen.json_text(FactsInFolder(**found.json(), folder=str(folder)), None))
    else:
        files = f"values   {VALUES}, for --set @FILE; fit.json; picture fit.png"
        print(f"{found.text()}{files}\nfolder   {folder}")
    with writing(folder):
        (folder / VALUES).write_text(found.settings(str(request.rig)), "utf-8")
        found.save(folder)
    named = {one.name for one in found.parameters if request.parameter and not one.excited}
    nothing = not any(one.excited for one in found.parameters)
    if named or nothing or not found.arrived:
        return Exit.NOT_MET
    return Exit.LOSS if found.missing else Exit.OK
