"""Commands: bisect."""

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def bisect(add: Add) -> None:
    """Take a rig, and two commits of the repository that holds it."""
    add("rig", metavar="RIG", help="a rig's name (pcpc rigs), file or folder")
    add("good", metavar="GOOD", help="git revision with the wanted bits")
    add("bad", metavar="BAD", help="later git revision whose bits differ")
    add("--controller", metavar="NAME", help="use this controller; default: the rig's")
    take.settings(add, "change a value of every run, as duration_s=2; @FILE: from pcpc save")
    add(
        "--duration",
        type=take.duration,
        metavar="DURATION",
        help="length of the runs; default: the rig's",
    )
    take.json(add)
    take.quiet(add)


COMMANDS = (
    Command(
        "bisect",
        "find the commit, cycle and signal that first changed the bits of a run",
        "pcpc bisect hull v1.2 HEAD\npcpc bisect step10 HEAD~9 HEAD --controller pid --duration 2s",
        bisect,
        notes="The commits of the repository that holds RIG run in virtual time, in a folder\n"
        "of their own: only test commits whose code you would run. If the repository\n"
        "is that of pcpc, its code comes from the commit, too.",
        judges=True,
        module="after.bisect.cli",
        codes=codes(
            OK="found",
            NOT_MET="equal bits, or several commits are left",
            LOSS="a disk is full",
            ENVIRONMENT="git is missing",
            INTERRUPTED="",
        ),
    ),
)
