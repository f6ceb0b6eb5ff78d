"""Commands: watchdog."""

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command


def watchdog(add: Add) -> None:
    """Take a rig, its bus, and what is fed while all is well."""
    take.rig(add)
    add("--bus", metavar="INTERFACE[:CHANNEL]", help=f"{take.BUSES}; the rig's run, if one goes on")
    add("--pacing", choices=("real", "sync", "lockstep"), help="of the run; the rig's")
    add(
        "--feed",
        metavar="FILE",
        help="written as long as all is well: /dev/watchdog, a relay's heartbeat",
    )


COMMANDS = (
    Command(
        "watchdog",
        "watch a run from its bus alone; send its stop frame if it goes wrong",
        "pcpc watchdog hull --bus vcan0 --feed /dev/watchdog",
        watchdog,
        codes={
            Exit.OK: "Ctrl-C, nothing was wrong",
            Exit.WRONG_INPUT: "",
            Exit.ENVIRONMENT: "",
            Exit.SAFETY_STOP: "the stop frame was sent",
        },
        notes="RIG needs a supervisor.stop_frame: docs/bus-safety.md",
        judges=True,
        compiles=True,
        module="live.watchdog.serve",
    ),
)
