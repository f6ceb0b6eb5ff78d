"""`pcpc report LOG`: a run as one HTML file that needs no network, to hand on or to print.

`-o FILE.md`: as Markdown, without its pictures; `-o -`: in the terminal.

`--suite`: all runs of a project by their requirements, see `suite`.

What it says, in this order: the verdict with its reasons, the figure of the evaluation,
requirements, metrics, what happened when, timing, bus, configuration, versions, how to replay.
"""

import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from pcpc.drivers.errors import Exit, UserError
from pcpc.tools.after.log.recorded import holds_several, log_of
from pcpc.tools.after.opened import opened
from pcpc.tools.after.report.commands import ReportRequest
from pcpc.tools.after.trust import Trust
from pcpc.tools.after.verdict.summary import Summary
from pcpc.tools.terminal.document import Part, Section, html, markdown, show, terminal
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.html import page
from pcpc.tools.terminal.outfile import LogCommandError, write_text
from pcpc.tools.terminal.progress import Progress
from pcpc.tools.terminal.rooms import part_of

if TYPE_CHECKING:
    from pcpc.tools.after.report.record import ReportedRun

FORMS = (".html", ".htm", ".md")


def command(request: ReportRequest) -> int:
    """Write the report of a log; LOSS if a part of the log is missing. UserError: wrong input."""
    if request.beside.value("audit"):
        return int(part_of("run/mcp", "report").command(request))
    suite = request.suite or request.logs
    if request.suite or len(suite) > 1 or any(map(holds_several, suite)):
        from pcpc.tools.after.report import suite_files  # time

        if request.suite and request.logs:
            raise UserError(f"{request.logs[0]}: give it after --suite, like the other runs")
        folder = "" if len(suite) > 1 else f", and {suite[0]} is a folder of them"
        request.refuse(f"of one log, not of several{folder}", "requirements", "require", "json")
        return suite_files.command(request.changed(suite=suite))
    request.refuse("only with several runs, or a folder of them", "junit", "need")
    if request.are_given("requirements", "require"):
        return _requirements(request)
    request.refuse("only with --requirements or --require", "json")
    if not request.logs:
        raise UserError("no log; name a log, a run folder or latest, or a folder of runs")
    path = log_of(request.logs[0])
    output = request.output or path.with_name(
        "report.html" if path.name == "log.mcap" else f"{path.stem}.html"
    )
    progress = Progress(request.quiet)
    missing = write(path, output, Trust.of(request.code), progress)
    progress.close()
    if missing and not request.quiet:
        more = f", and {len(missing) - 1} more" if missing[1:] else ""
        print(f"{path}: missing: {missing[0]}{more}", file=sys.stderr)
    if str(output) != "-":
        print(output)
    return Exit.LOSS if missing else Exit.OK


def _requirements(request: ReportRequest) -> int:
    """Print what became of the requirements of a log, and nothing else."""
    request.refuse("no page is written of requirements alone", "output")
    if not request.logs:
        raise UserError("no log; name a log, a run folder or latest")
    about = log_of(request.logs[0]), request.beside, Trust.of(request.code), request.quiet
    return int(part_of("after/log", "require").tell_requirements(*about))


def write(
    path: Path,
    output: Path,
    trust: Trust,
    progress: Progress,
    summary: Summary | None = None,
) -> list[str]:
    """Write the report of a log to `output`; return what is missing in the log.

    LogError if it is none, UserError where the page cannot be written. `summary`: of the run, if
    it is known.
    """
    if output.suffix.lower() not in FORMS and str(output) != "-":
        raise LogCommandError(
            f"-o {output}: neither a page nor Markdown; expected FILE.html, FILE.md, or -"
        )
    is_page = output.suffix.lower() in FORMS[:2]
    if is_page:
        need("a report needs", FIGURE)
    from pcpc.tools.after.report.record import gather  # time

    with opened(path, trust) as run:
        record = gather(run, progress, summary)
        record.is_drawn = is_page
        report = report_of(record)
        title = f"{record.facts.get('rig', '')}, {record.facts.get('controller', '')}"
    if str(output) == "-":
        progress.close()
        show(terminal(report), 0)
    else:
        write_text(output, _page(title, report) if is_page else markdown(report, level=1))
    return [*record.log.missing, *record.tally.left_out()]


def report_of(record: "ReportedRun") -> Section:
    """Return all that is told of a run: facts, verdict, and the chapters of a page."""
    from pcpc.tools.after.report import details, sections  # time

    with tempfile.TemporaryDirectory(prefix="pcpc-report-") as folder:
        chapters: dict[str, list[Part]] = {
            "Figure": [sections.figure(record, Path(folder))],
            "Requirements": [sections.requirements(record)],
            "Metrics": [sections.metrics(record)],
            "Course": sections.course(record),
            "Timing": details.timing(record),
            "Bus": details.bus(record),
            "Configuration": details.configuration(record),
            "Versions": [details.versions(record)],
            "Replay": details.replay(record),
        }
    told = [Section(name, parts) for name, parts in chapters.items()]
    return Section(
        sections.title(record), [sections.facts(record), sections.verdict(record), *told]
    )


def _page(title: str, report: Section) -> str:
    chapters = [part for part in report.parts if isinstance(part, Section)]
    facts, verdict = report.parts[:2]
    bodies = {one.title: body for one in chapters if (body := html(one))}
    contents = "".join(f'<a href="#{name}">{name}</a> ' for name in bodies)
    heading = html(Section(report.title, [facts]), 1)
    return page(title, [heading, html(verdict), f"<nav>{contents}</nav>", *bodies.values()])
