"""Commands: generate."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes
from pcpc.tools.terminal.rooms import offers


def c(add: Add) -> None:
    """Take laws or a rig, where to write, and what to tell of it."""
    add(
        "what",
        metavar="LAW|RIG",
        help="a law: pd, references:sine, plants/atb1000/model.py; or a rig: a name (pcpc rigs), "
        "a file",
    )
    add("--controller", metavar="NAME", help="of a rig: use this controller")
    take.settings(add, "of a rig: change a value of it or of a block")
    add("-o", "--output", type=Path, metavar="DIR", help="folder; default: NAME_c")
    add(
        "--device",
        action="store_true",
        help="of a rig: also frames, CRC, supervisor, a main for Linux and Cortex-M",
    )
    add(
        "--check",
        action="store_true",
        help="of a rig: run its closed loop in C, in every build that this machine can make, "
        "and compare with `pcpc simulate`",
    )
    add(
        "--single",
        action="store_true",
        help="float, not double; --check compares the builds, and the run with double",
    )
    add(
        "--cost",
        action="store_true",
        help="instructions and stack on Cortex-M7 and M4",
    )
    add(
        "--cycles",
        type=take.positive,
        default=200,
        metavar="N",
        help="--check, --cost: number of cycles; default: %(default)s",
    )
    for more in offers("BESIDE_C"):
        more(add)
    take.quiet(add, "-q")


_PARTS = (
    Command(
        "c",
        "write readable C99 of a law, or of a rig's executive",
        "pcpc generate c pd_nn_fast -o firmware\n"
        "pcpc generate c hull --controller pd_nn_fast --check",
        c,
        compiles=True,
        module="make.generate.cli",
        codes=codes(
            NOT_MET="a build gives other bits",
            ENVIRONMENT="a compiler is missing, or DIR cannot be written",
        ),
    ),
)

COMMANDS = (
    Command(
        "generate",
        "write bit-identical C of laws and rigs, or an FMU of a plant",
        "pcpc generate c pd -o firmware",
        compiles=True,
        parts=_PARTS,
    ),
)
