"""Commands: report."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import OUTPUT_CODES, Command, codes
from pcpc.tools.terminal.request import WORD, Offers, Request
from pcpc.tools.terminal.rooms import Room


class ReportRequest(Request):
    """A log, or all runs of a suite, and a page."""

    logs: Annotated[
        Sequence[str],
        WORD,
        "LOG",
        "log file, run folder or latest; several, or a folder of runs: the suite of them",
    ] = ()
    suite: Annotated[
        Sequence[str],
        "DIR|LOG",
        "all runs below folders, and logs: one page with the result of each requirement",
        {"nargs": "+"},
    ] = ()
    need: Annotated[
        Sequence[str],
        "ID[,ID]",
        "with --suite: list these ids as not judged if no run tests them",
    ] = ()
    junit: Annotated[
        Path | None, "FILE.xml", "with --suite: a testcase for each requirement and rig"
    ] = None
    output: Annotated[
        Path | None,
        "-o",
        "FILE",
        "FILE.html, of one run also FILE.md, or - for the terminal; default: report.html in the "
        "run folder, LOG.html by a log, suite.html",
    ] = None
    beside: Annotated[Offers, "BESIDE_REPORT"] = Offers()
    code: take.CodeOfLaws = take.CodeOfLaws()
    quiet: take.Quiet = False


COMMANDS = (
    Command(
        "report",
        "write a run, or a suite of runs, as a page; a run also as text",
        "pcpc report latest\npcpc report runs/A -o a.html\npcpc report latest -o -\n"
        "pcpc report latest --requirements\n"
        "pcpc report latest --require 'never: abs(controller.e_rad) > 5 mrad, after: 1s'\n"
        "pcpc report --suite runs -o suite.html --junit suite.xml",
        ReportRequest,
        module="after.report.cli",
        codes=codes(OUTPUT_CODES, NOT_MET="not met, or not judged: the suite, a requirement"),
        first=True,
    ),
)
ROOM = Room(
    "docs/howto/ci.md", "tests/tools/after/test_suite.py", "report latest",
    needed_by=("run/mcp/report.py",),
)  # fmt: skip
