"""Commands: report."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import OUTPUT_CODES, Add, Command


def report(add: Add) -> None:
    """Take a log, and a page."""
    add("log", metavar="LOG", help="log file, run folder or latest")
    add("-o", "--output", type=Path, metavar="FILE.html",
        help="instead of report.html in the run folder, LOG.html beside another log")  # fmt: skip
    take.code_of_laws(add)
    take.quiet(add)


COMMANDS = (
    Command(
        "report",
        "write a run as one HTML file, to hand on or to print",
        "pcpc report latest\npcpc report runs/A -o a.html",
        report,
        reads_logs=True,
        module="after.report.cli",
        codes=OUTPUT_CODES,
        first=True,
    ),
)
