"""`pcpc report LOG`: a run as one HTML file that needs no network, to hand on or to print.

`--suite`: all runs of a project by their requirements, see `suite`.

What it says, in this order: the verdict with its reasons, the figure of the evaluation,
requirements, metrics, what happened when, timing, bus, configuration, versions, how to replay.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.tools.after.log.recorded import log_of
from pcpc.tools.after.verdict.summary import Summary
from pcpc.tools.terminal.document import Part, Section, html
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.html import page
from pcpc.tools.terminal.option_notes import refuse
from pcpc.tools.terminal.outfile import LogCommandError, write_text
from pcpc.tools.terminal.progress import Progress

SUFFIXES = (".html", ".htm")


def command(options: argparse.Namespace) -> int:
    """Write the report of a log; LOSS if a part of the log is missing. UserError: wrong input."""
    if options.suite:
        from pcpc.tools.after.report import suite_files  # time

        if options.log is not None:
            raise UserError(f"{options.log}: give it after --suite, like the other runs")
        return suite_files.command(options, Progress(options.quiet))
    refuse(options, "only with --suite", "junit", "need")
    if options.log is None:
        raise UserError("no log; name a log, a run folder or latest, or runs with --suite")
    path = log_of(options.log)
    output = options.output or path.with_name(
        "report.html" if path.name == "log.mcap" else f"{path.stem}.html"
    )
    progress = Progress(options.quiet)
    missing = write(path, output, options, progress)
    progress.close()
    if missing and not options.quiet:
        more = f", and {len(missing) - 1} more" if missing[1:] else ""
        print(f"{path}: missing: {missing[0]}{more}", file=sys.stderr)
    print(output)
    return Exit.LOSS if missing else Exit.OK


def write(
    path: Path,
    output: Path,
    options: argparse.Namespace,
    progress: Progress,
    summary: Summary | None = None,
) -> list[str]:
    """Write the report of a log to `output`; return what is missing in the log.

    LogError if it is none, UserError where the page cannot be written. `options`: whose code of
    the log may run, see `tools.after.log.rig`; `summary`: of the run, if it is known.
    """
    if output.suffix.lower() not in SUFFIXES:
        raise LogCommandError(f"-o {output}: not an HTML file; expected FILE.html")
    need("a report needs", FIGURE)
    from pcpc.tools.after.report import details, sections  # time
    from pcpc.tools.after.report.record import gather

    with tempfile.TemporaryDirectory(prefix="pcpc-report-") as folder:
        record = gather(path, Path(folder), options, progress, summary)
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
    bodies = {
        name: body for name, parts in chapters.items() if (body := html(Section(name, parts)))
    }
    heading = html(Section(sections.title(record), [sections.facts(record)]), 1)
    contents = "".join(f'<a href="#{name}">{name}</a> ' for name in bodies)
    parts = [heading, html(sections.verdict(record)), f"<nav>{contents}</nav>", *bodies.values()]
    title = f"{record.facts.get('rig', '')}, {record.facts.get('controller', '')}"
    write_text(output, page(title, parts))
    return [*record.log.missing, *record.tally.left_out()]
