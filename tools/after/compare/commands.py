"""Commands: compare."""

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def compare(add: Add) -> None:
    """Take two runs, or a version and rigs, and where to tell what differs."""
    add(
        "words",
        nargs="*",
        metavar="A B|RIG",
        help="old and new log, run or folder of runs; --against: rigs",
    )
    add(
        "--against",
        metavar="GITREF",
        help="simulate the rigs of this git version and of the working tree",
    )
    add("--controller", metavar="NAME", help="--against: this controller of each rig")
    add("--all-controllers", action="store_true", help="--against: all controllers of each rig")
    add("--jobs", type=int, metavar="N", help="--against: processes; default: one a processor")
    add(
        "--tolerance",
        type=float,
        default=0.0,
        metavar="REL",
        help="relative change of a metric that counts as equal",
    )
    add(
        "--fail-on",
        choices=("any", "metrics", "verdict", "never"),
        default="any",
        help="difference that exits with 1; default: any",
    )
    add(
        "--allow",
        action="append",
        default=[],
        metavar="NAME",
        help="rig, or RIG/CONTROLLER, that may be on one side only",
    )
    add("--markdown", metavar="FILE", help="write a table for a pull request; -: stdout")
    add("--json", metavar="FILE", help="write all as JSON; -: stdout")
    add("-o", "--output", metavar="DIR", help="folder for report.md and figures of old over new")
    take.quiet(add)


COMMANDS = (
    Command(
        "compare",
        "compare two runs, or two versions of the rigs",
        "pcpc compare runs/A runs/B\n"
        "pcpc compare --against origin/main --markdown table.md -o compared",
        compare,
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
