"""The part of `pcpc generate` that makes a page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class WebRequest(Request):
    """A rig, what is changed of it, and where its page goes."""

    rig: Annotated[str, "RIG", "name of a rig (pcpc rigs), or its file"]
    controller: Annotated[str | None, "NAME", "of its controllers only this; default: all"] = None
    set: Annotated[Sequence[str], "NAME=VALUE", "change a value of the rig or a block"] = ()
    output: Annotated[Path | None, "-o", "FILE", "default: RIG.html"] = None
    quiet: take.ShortQuiet = False


COMMANDS: tuple[Command, ...] = ()
PARTS_OF = {
    "generate": (
        Command(
            "web",
            "write a rig as one HTML file that runs in any browser, bit-identical",
            "pcpc generate web hull -o hull.html",
            WebRequest,
            compiles=True,
            module="make.web.cli",
            codes=codes(ENVIRONMENT="no compiler for wasm32, or FILE cannot be written"),
        ),
    )
}
ROOM = Room(
    "docs/howto/generate.md",
    "tests/tools/make/web",
    "generate web probe",
    refused="'web' is not known",
)
