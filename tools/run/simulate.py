"""`pcpc simulate`: a rig in virtual time, from its file to a run folder with a verdict."""

import sys
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.log.long_logs import Wanted
from pcpc.executive.nodes import without_effect
from pcpc.executive.nodes.external import External
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.own_laws import carried_files
from pcpc.executive.rig.buses import on_line
from pcpc.executive.rig.messages import unsent_lines
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.run_digest import run_digest
from pcpc.tools.after.verdict.conclude import conclude
from pcpc.tools.after.verdict.judge import Judge, columns_to_keep
from pcpc.tools.after.verdict.outcome import Outcome, changed_settings
from pcpc.tools.after.verdict.virtual_end import to_end
from pcpc.tools.run.commands import SimulateRequest
from pcpc.tools.run.outlived import outlived
from pcpc.tools.start.children import on_request
from pcpc.tools.start.folder import LINE, LOG, run_folder
from pcpc.tools.terminal.progress import Progress


class Simulation:
    """A rig of which all blocks can run, in virtual time into the file `log`."""

    def __init__(
        self,
        rig: Rig,
        log: Path,
        judged: Wanted,
        outcome: Outcome,
        controller: External | None = None,
    ) -> None:
        """`judged`: of the recorder; `controller`: of VirtualRun. RigError, BusError."""
        self.rig, self.outcome = rig, outcome
        self.run = VirtualRun(rig, log, judged, controller, without_effect.check)
        self.lacking = carried_files.missing_warning(self.run.blocks[0].description["files"])

    def interrupt(self, *_: Any) -> None:
        """Ask it to end; also what hears a signal."""
        self.outcome.interrupted = True
        self.run.stop()

    def tell_line(self, folder: Path) -> str:
        """Write what became of an emulated line, and return it in a line; "" without one.

        A node of another bit rate is a fault.
        """
        if not self.run.over:
            return ""
        from pcpc.tools.start.bus import line_report  # here, because few rigs need it

        found = line_report.numbers(self.run.over[0], on_line(self.rig))
        line_report.write(found, folder / LINE)
        self.outcome.faults[:0] = line_report.mismatches(found)
        return line_report.summary(found)

    def to_end(self, progress: Progress) -> None:
        """Run it; what came of it goes into the outcome."""
        to_end(self.run, self.outcome, progress)


def command(request: SimulateRequest) -> int:
    """Run a rig in virtual time and sum up; return the exit code."""
    if request.digest and request.kept.json:
        raise UserError("--digest is a line of its own; leave out --json")
    rig = load_rig(request.rig, request.controller, request.set)
    if request.digest and rig.config.record.keep is not None:
        raise UserError("--digest is of a whole run; leave out record.keep")
    code = outlived(rig)
    if code is not None:
        return code
    judge = Judge.of(rig)
    judged = columns_to_keep(judge, "lockstep", not request.kept.no_figure)
    outcome = Outcome(
        "virtual", "memory", changed=changed_settings(request.set), strict=request.kept.judge
    )
    with run_folder(request.kept.output, rig) as folder:
        simulation = Simulation(rig, folder / LOG, judged, outcome)
        for line in filter(None, [simulation.lacking, *unsent_lines(rig)]):
            print(line, file=sys.stderr)
        on_request(simulation.interrupt)
        progress = Progress(request.kept.quiet)
        simulation.to_end(progress)
        if said := simulation.tell_line(folder):
            progress.say(said)
        code = conclude(judge, folder, outcome, request.kept, judged)
        if request.digest and code in (Exit.OK, Exit.NOT_MET):
            print(f"digest   {run_digest(Opened(folder / LOG).log)}")
        return code
