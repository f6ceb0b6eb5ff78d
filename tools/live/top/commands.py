"""Commands: top."""

from pcpc.drivers.errors import Exit
from pcpc.tools.live import arguments as take_live
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import BASIC_CODES, Add, Command


def top(add: Add) -> None:
    """Take which run, and how often."""
    add(
        "run",
        metavar="RIG|RUN",
        nargs="?",
        help="only runs of this rig, its name or its file; or one run, as RIG.BUS",
    )
    add("--node", metavar="NODE", help="of several runs: a node, or RIG.BUS")
    add(
        "--every",
        type=take.seconds("--every"),
        default="1s",
        metavar="TIME",
        help="interval; %(default)s",
    )
    add("--once", action="store_true", help="one screen, then end")
    take_live.at(add)


COMMANDS = (
    Command(
        "top",
        "show a run on one screen: states, faults, timing, frames, parameters",
        "pcpc top\npcpc top hull --once",
        top,
        notes="q or Ctrl-C ends it; where a run ends, it waits for the next",
        module="live.top.cli",
        codes={**BASIC_CODES, Exit.ENVIRONMENT: "--once: no such run", Exit.INTERRUPTED: ""},
    ),
)
