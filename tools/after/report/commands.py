"""Commands: report."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import OUTPUT_CODES, Add, Command, codes


def report(add: Add) -> None:
    """Take a log, or all runs of a suite, and a page."""
    take.log(add, nargs="?")
    add(
        "--suite",
        nargs="+",
        default=[],
        metavar="DIR|LOG",
        help="all runs below folders, and logs: one page with the result of each requirement",
    )
    take.several(
        add, "--need", "ID[,ID]", "with --suite: list these ids as not judged if no run tests them"
    )
    add(
        "--junit",
        type=Path,
        metavar="FILE.xml",
        help="with --suite: a testcase for each requirement and rig",
    )
    add(
        "-o",
        "--output",
        type=Path,
        metavar="FILE.html",
        help="default: report.html in the run folder, LOG.html by a log, suite.html",
    )
    take.code_of_laws(add)
    take.quiet(add)


COMMANDS = (
    Command(
        "report",
        "write a run, or a suite of runs, as one HTML file",
        "pcpc report latest\npcpc report runs/A -o a.html\n"
        "pcpc report --suite runs -o suite.html --junit suite.xml",
        report,
        module="after.report.cli",
        codes=codes(OUTPUT_CODES, NOT_MET="the suite is not ok, or not judged"),
        first=True,
    ),
)
