"""Commands: generate."""

from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command


def c(add: Add) -> None:
    """Take laws or a rig, where to write, and what to tell of it."""
    add(
        "what",
        metavar="LAW|RIG",
        help="a law: pd, references:sine, plants/atb1000/model.py; or a rig: a name (pcpc rigs), "
        "a file",
    )
    add("--controller", metavar="NAME", help="of a rig: another controller than its own")
    take.settings(add, "of a rig: any value of it or of a block")
    add("-o", "--output", type=Path, metavar="DIR", help="where to write; default: NAME_c")
    add(
        "--device",
        action="store_true",
        help="of a rig: also frames, counters, CRC, supervisor, a main for Linux and for a "
        "Cortex-M",
    )
    add(
        "--check",
        action="store_true",
        help="of a rig: run its closed loop in C in every build of this machine, compare with "
        "`pcpc simulate`; exit code 4 where it has no compiler",
    )
    add(
        "--single",
        action="store_true",
        help="floats instead of doubles; with --check the builds with each other, and the whole "
        "run with double; with --cost beside double",
    )
    add(
        "--cost",
        action="store_true",
        help="instructions and stack of a law, or of a rig's controllers, on Cortex-M7 and M4",
    )
    add(
        "--cycles",
        type=take.positive,
        default=200,
        metavar="N",
        help="--check, --cost: the first of the run; default: %(default)s",
    )
    take.quiet(add, "-q")


_PARTS = (
    Command(
        "c",
        "write readable C99 of a law, or of all laws of a rig's executive, wired",
        "pcpc generate c pd_nn_fast -o firmware\n"
        "pcpc generate c hull --controller pd_nn_fast --check",
        c,
        compiles=True,
        module="make.generate.cli",
        codes={
            Exit.OK: "",
            Exit.NOT_MET: "a build gives other bits",
            Exit.WRONG_INPUT: "",
            Exit.ENVIRONMENT: "a compiler is missing, or DIR cannot be written",
        },
    ),
)

COMMANDS = (
    Command(
        "generate",
        "write C from laws and rigs, or an FMU of a plant, with their bits",
        "pcpc generate c pd -o firmware",
        compiles=True,
        parts=_PARTS,
    ),
)
