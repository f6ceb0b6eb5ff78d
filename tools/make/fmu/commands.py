"""The part of `pcpc generate` that makes an FMU."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def fmu(add: Add) -> None:
    """Take a rig, which block of its plant, and where to write."""
    add("rig", metavar="RIG", help="name of a rig (pcpc rigs), or its file")
    add("--block", metavar="NAME", help="block of the plant; default: the only one")
    take.settings(add, "change a value of the rig or a block")
    add("-o", "--output", type=Path, metavar="FILE", help="default: BLOCK.fmu")


COMMANDS: tuple[Command, ...] = ()
PARTS_OF = {
    "generate": (
        Command(
            "fmu",
            "write a bit-identical FMU of a rig's plant (FMI 2.0, co-simulation)",
            "pcpc generate fmu slew10 -o barrel.fmu",
            fmu,
            compiles=True,
            module="make.fmu.cli",
            codes=codes(ENVIRONMENT="no compiler, or FILE cannot be written"),
        ),
    )
}
