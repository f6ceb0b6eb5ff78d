"""Commands: watchdog."""

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def watchdog(add: Add) -> None:
    """Take a rig, its bus, and what is fed while all is well."""
    take.rig(add)
    add("--bus", metavar="INTERFACE[:CHANNEL]", help=f"{take.BUSES}; the rig's run, if one goes on")
    add(
        "--pacing",
        choices=("real", "sync", "lockstep"),
        help="pacing of the run; default: the rig's",
    )
    add(
        "--feed",
        metavar="FILE",
        help="write here as long as all is well: /dev/watchdog, a relay",
    )


COMMANDS = (
    Command(
        "watchdog",
        "watch a run from its bus alone; send the stop frame on a fault",
        "pcpc watchdog hull --bus vcan0 --feed /dev/watchdog",
        watchdog,
        codes=codes(
            OK="Ctrl-C, nothing was wrong",
            ENVIRONMENT="",
            SAFETY_STOP="the stop frame was sent",
        ),
        notes="RIG needs a supervisor.stop_frame: docs/bus-safety.md",
        judges=True,
        compiles=True,
        module="live.watchdog.serve",
    ),
)
