"""Commands: compare."""

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command


def compare(add: Add) -> None:
    """Take two runs, or a version and rigs, and where to tell what differs."""
    add("words", nargs="*", metavar="A B|RIG",
        help="two logs, runs or folders of runs, old and new; with --against: rigs")  # fmt: skip
    add("--against", metavar="GITREF",
        help="run the rigs of this version and of the working tree in virtual time")  # fmt: skip
    add("--controller", metavar="NAME", help="with --against: this controller of each rig")
    add("--all-controllers", action="store_true", help="with --against: all of each rig")
    add("--jobs", type=int, metavar="N", help="with --against: processes; all processors")
    add("--tolerance", type=float, default=0.0, metavar="REL",
        help="metrics that change by no more than this share are equal")  # fmt: skip
    add("--fail-on", choices=("any", "metrics", "verdict", "never"), default="any",
        help="what ends with exit code 1; any difference")  # fmt: skip
    add("--markdown", metavar="FILE", help="a table for a pull request; - is stdout")
    add("--json", metavar="FILE", help="everything as one JSON object; - is stdout")
    add("-o", "--output", metavar="DIR", help="report.md and figures of old over new")
    take.quiet(add)


COMMANDS = (
    Command(
        "compare",
        "tell what two runs, or two versions of the rigs, differ in",
        "pcpc compare runs/A runs/B\n"
        "pcpc compare --against origin/main --markdown table.md -o compared",
        compare,
        judges=True,
        module="after.compare.cli",
        codes={
            Exit.OK: "equal",
            Exit.NOT_MET: "they differ, or a log is damaged",
            Exit.WRONG_INPUT: "",
            Exit.LOSS: "a disk is full",
            Exit.ENVIRONMENT: "git, a package is missing",
            Exit.INTERRUPTED: "",
        },
    ),
)
