"""The part of `pcpc generate` that makes an FMU."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class FmuRequest(Request):
    """A rig, which block of its plant, and where its FMU goes."""

    rig: Annotated[str, "RIG", "name of a rig (pcpc rigs), or its file"]
    block: Annotated[str | None, "NAME", "block of the plant; default: the only one"] = None
    set: Annotated[Sequence[str], "NAME=VALUE", "change a value of the rig or a block"] = ()
    output: Annotated[Path | None, "-o", "FILE", "default: BLOCK.fmu"] = None


COMMANDS: tuple[Command, ...] = ()
PARTS_OF = {
    "generate": (
        Command(
            "fmu",
            "write a bit-identical FMU of a rig's plant (FMI 2.0, co-simulation)",
            "pcpc generate fmu slew10 -o barrel.fmu",
            FmuRequest,
            compiles=True,
            module="make.fmu.cli",
            codes=codes(ENVIRONMENT="no compiler, or FILE cannot be written"),
        ),
    )
}
ROOM = Room(
    "docs/howto/fmu.md", "tests/tools/make/fmu", "generate fmu probe", refused="'fmu' is not known"
)
