"""Commands: step."""

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command


def step(add: Add) -> None:
    """Take a log, one of its cycles, and which variables are shown."""
    add("log", metavar="LOG", help="log file, run folder or latest")
    take.moment(add, "cycle to show")
    add(
        "--show",
        action="append",
        default=[],
        metavar="NAME",
        help="only this variable; * is any text; default: all but parameters",
    )
    take.node(add)
    take.code_of_laws(add)
    take.json(add)
    take.quiet(add)


COMMANDS = (
    Command(
        "step",
        "show one cycle of a log stage by stage, hidden states included",
        "pcpc step latest --cycle 2000\n"
        "pcpc step latest --time 2 --show 'controller.w_*' --show 'barrel.*'",
        step,
        notes="The cycles before are recomputed and compared with the log.",
        compiles=True,
        reads_logs=True,
        module="after.step.cli",
    ),
)
