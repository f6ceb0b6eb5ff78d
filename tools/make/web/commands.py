"""The part of `pcpc generate` that makes a page."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def web(add: Add) -> None:
    """Take a rig, what to change of it, and where to write."""
    add("rig", metavar="RIG", help="name of a rig (pcpc rigs), or its file")
    add("--controller", metavar="NAME", help="of its controllers only this; default: all")
    take.settings(add, "change a value of the rig or a block")
    add("-o", "--output", type=Path, metavar="FILE", help="default: RIG.html")
    take.quiet(add, "-q")


COMMANDS: tuple[Command, ...] = ()
PARTS_OF = {
    "generate": (
        Command(
            "web",
            "write a rig as one HTML file that runs in any browser, bit-identical",
            "pcpc generate web hull -o hull.html",
            web,
            compiles=True,
            module="make.web.cli",
            codes=codes(ENVIRONMENT="no compiler for wasm32, or FILE cannot be written"),
        ),
    )
}
