"""Commands: replay."""

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def replay(add: Add) -> None:
    """Take a log, and what is changed."""
    take.log(add)
    take.node(
        add, "node to recompute; device: its frames, by the rig's law; default: all", "device"
    )
    take.moment(add, "show this cycle only, as `pcpc step` does")
    add(
        "--from",
        dest="since",
        type=float,
        metavar="S",
        help="first time that is compared, s of the run",
    )
    add("--to", dest="until", type=float, metavar="S", help="last time that is compared, s")
    add(
        "--show",
        action="append",
        default=[],
        metavar="NAME",
        help="print this variable as CSV, a row a cycle; * is any text",
    )
    add("--controller", metavar="NAME", help="use another controller of the log's rig")
    take.settings(add, "recompute with a change, in open loop: recorded frames stay")
    take.code_of_laws(add)
    take.json(add)
    take.quiet(add)


COMMANDS = (
    Command(
        "replay",
        "recompute a recorded run and compare it bit by bit",
        "pcpc replay latest",
        replay,
        codes=codes(
            OK="all bit-identical",
            NOT_MET="something differs",
            LOSS="nothing differs, but the log is incomplete",
            SAFETY_STOP="a law hangs or raises",
            INTERRUPTED="",
        ),
        judges=True,
        compiles=True,
        reads_logs=True,
        module="after.replay",
        first=True,
    ),
)
