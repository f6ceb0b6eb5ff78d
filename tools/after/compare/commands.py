"""Commands: compare."""

from collections.abc import Sequence
from typing import Annotated, Literal

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import WORD, Offers, Request
from pcpc.tools.terminal.rooms import Room


class CompareRequest(Request):
    """Two runs, or a version and rigs, and where to tell what differs."""

    words: Annotated[
        Sequence[str],
        WORD,
        "A B|RIG",
        "old and new log, run or folder of runs; --against: rigs; --bits: then variables",
    ] = ()
    against: Annotated[
        str | None, "GITREF", "simulate the rigs of this git version and of the working tree"
    ] = None
    controller: Annotated[str | None, "NAME", "--against: this controller of each rig"] = None
    all_controllers: Annotated[bool, "--against: all controllers of each rig"] = False
    jobs: Annotated[int | None, "N", "--against: processes; default: one a processor"] = None
    tolerance: Annotated[
        float,
        "REL",
        "relative change of a metric, --bits: of a value, that counts as equal",
    ] = 0.0
    fail_on: Annotated[
        Literal["any", "metrics", "verdict", "never"],
        "difference that exits with 1; default: any",
    ] = "any"
    allow: Annotated[
        Sequence[str], "NAME", "rig, or RIG/CONTROLLER, that may be on one side only"
    ] = ()
    markdown: Annotated[str | None, "FILE", "write a table for a pull request; -: stdout"] = None
    json: Annotated[str | None, "FILE", "write all as JSON; -: stdout"] = None
    output: Annotated[
        str | None, "-o", "DIR", "folder for report.md and figures of old over new"
    ] = None
    beside: Annotated[Offers, "BESIDE_COMPARE"] = Offers()
    quiet: take.Quiet = False


COMMANDS = (
    Command(
        "compare",
        "compare two runs, or two versions of the rigs",
        "pcpc compare runs/A runs/B\n"
        "pcpc compare --bits runs/A runs/B 'controller.*' --absolute 1e-9\n"
        "pcpc compare --against origin/main --markdown table.md -o compared",
        CompareRequest,
        judges=True,
        module="after.compare.cli",
        codes=codes(
            OK="equal",
            NOT_MET="they differ, or one is alone or no log",
            LOSS="nothing differs, but a log is cut; a disk is full",
            ENVIRONMENT="git or a package is missing",
            INTERRUPTED="",
        ),
    ),
)
ROOM = Room(
    "docs/howto/ci.md",
    "tests/tools/after/test_compare.py",
    "compare a b",
    needed_by=("after/bisect", "after/branch"),
)
