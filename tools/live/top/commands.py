"""Commands: top."""

from pcpc.tools.live import arguments as take_live
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def top(add: Add) -> None:
    """Take which run, and how often."""
    add(
        "run",
        metavar="RIG|RUN",
        nargs="?",
        help="runs of this rig, by name or file, or one run: RIG.BUS",
    )
    add("--node", metavar="NODE", help="a node, if several run, or RIG.BUS")
    add(
        "--every",
        type=take.seconds("--every"),
        default="1s",
        metavar="TIME",
        help="interval; default: %(default)s",
    )
    add("--once", action="store_true", help="print one screen and end")
    take_live.at(add)


COMMANDS = (
    Command(
        "top",
        "show a run on one screen: states, faults, timing, frames, parameters",
        "pcpc top\npcpc top hull --once",
        top,
        notes="q or Ctrl-C quits; after a run it waits for the next",
        module="live.top.cli",
        codes=codes(ENVIRONMENT="--once: no such run", INTERRUPTED=""),
    ),
)
