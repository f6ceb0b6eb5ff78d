"""Commands: report."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import OUTPUT_CODES, Add, Command


def report(add: Add) -> None:
    """Take a log, and a page."""
    add("log", metavar="LOG", help="log file, run folder or latest")
    add("-o", "--output", type=Path, metavar="FILE.html",
        help="default: report.html in the run folder, or LOG.html beside a log")  # fmt: skip
    take.code_of_laws(add)
    take.quiet(add)


COMMANDS = (
    Command(
        "report",
        "write a run as one HTML file",
        "pcpc report latest\npcpc report runs/A -o a.html",
        report,
        reads_logs=True,
        module="after.report.cli",
        codes=OUTPUT_CODES,
        first=True,
    ),
)
