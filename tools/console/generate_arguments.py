"""What the parts of `pcpc generate` take."""

from pathlib import Path

from pcpc.tools.console.arguments import _set, positive, quiet
from pcpc.tools.console.command import Add


def c(add: Add) -> None:
    """Take laws or a rig, where to write, and what to tell of it."""
    add("what", metavar="LAW|RIG",
        help="a law: pd, references:sine, plants/atb1000/model.py; or a rig: a name (pcpc rigs), "
        "a file")  # fmt: skip
    add("--controller", metavar="NAME", help="of a rig: another controller than its own")
    _set(add, "of a rig: any value of it or of a block")
    add("-o", "--output", type=Path, metavar="DIR", help="where to write; default: NAME_c")
    add("--device", action="store_true",
        help="of a rig: also frames, counters, CRC, supervisor, a main for Linux and for a "
        "Cortex-M")  # fmt: skip
    add("--check", action="store_true",
        help="of a rig: run its closed loop in C in every build of this machine, compare with "
        "`pcpc simulate`")  # fmt: skip
    add("--single", action="store_true",
        help="floats instead of doubles; with --check the builds with each other, and the whole "
        "run with double; with --cost beside double")  # fmt: skip
    add("--cost", action="store_true",
        help="instructions and stack of a law, or of a rig's controllers, on Cortex-M7 and "
        "M4")  # fmt: skip
    add("--cycles", type=positive, default=200, metavar="N",
        help="--check, --cost: the first of the run; default: %(default)s")  # fmt: skip
    quiet(add, "-q")


def fmu(add: Add) -> None:
    """Take a rig, which block of its plant, and where to write."""
    add("rig", metavar="RIG", help="name of a rig (pcpc rigs), or its file")
    add("--block", metavar="NAME", help="which block of the plant; without one, the only one")
    _set(add, "any value of the rig or of a block")
    add("-o", "--output", type=Path, metavar="FILE", help="default: BLOCK.fmu")
