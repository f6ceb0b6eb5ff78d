"""Commands: branch."""

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command


def branch(add: Add) -> None:
    """Take a log, a cycle, and what is different from there on."""
    add("log", metavar="LOG", help="log file, run folder or latest")
    take.moment(add, "first cycle that is different, of the executive")
    take.settings(
        add,
        "set a parameter there, as controller.kv_Nms_rad=130; NODE:NAME=VALUE "
        "where several nodes have it",
    )
    add("--controller", metavar="NAME", help="hand over to this controller there")
    add(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[:DURATION]",
        help="begin a fault of the rig there; default duration: to the end",
    )
    add(
        "--duration",
        type=take.duration,
        metavar="DURATION",
        help="length of the whole run; default: as the log's rig",
    )
    add(
        "--bus",
        metavar="INTERFACE[:CHANNEL]",
        help="go on over this bus in lockstep, auto: a free one; default: none",
    )
    take.code_of_laws(add)
    take.run_folder(add)


COMMANDS = (
    Command(
        "branch",
        "continue a recorded run with a change from a cycle on, in closed loop",
        "pcpc branch latest --cycle 4000 --set controller.kv_Nms_rad=130\n"
        "pcpc branch latest --time 2 --controller pid --duration 20s",
        branch,
        notes="All nodes continue in virtual time. The new run is complete from cycle 0.\n"
        "Without a change the branch is bit-identical to a virtual or lockstep log.",
        judges=True,
        compiles=True,
        reads_logs=True,
        module="after.branch.cli",
    ),
)
