"""Commands: new, dbc."""

from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal.command import BASIC_CODES, Add, Command


def new(add: Add) -> None:
    """Take a folder, and what is to be in it."""
    add("dir", type=Path, metavar="DIR", help="a new or empty folder; its name is the rig's")
    add(
        "--device",
        action="store_true",
        help="also the law as a program of its own in the executive's place",
    )


def dbc(add: Add) -> None:
    """Take a rig, and where to write."""
    add("rig", metavar="RIG", help="its file or folder; its DBC file need not be there")
    add("-o", "--output", metavar="FILE", help="default: the file that the rig names")
    add(
        "--crc",
        type=int,
        choices=(8, 16),
        default=8,
        help="its bits, of every frame of every cycle; 16 as in AUTOSAR's E2E profile 5",
    )


COMMANDS = (
    Command(
        "new",
        "write a rig of your own to begin with: a DC motor with an encoder",
        "pcpc new my-motor\npcpc new my-motor --device",
        new,
        codes={**BASIC_CODES, Exit.ENVIRONMENT: "the folder cannot be written"},
        module="make.new",
        first=True,
    ),
    Command(
        "dbc",
        "write a DBC file from the wiring of a rig that has none",
        "pcpc dbc probe -o new.dbc",
        dbc,
        codes={**BASIC_CODES, Exit.ENVIRONMENT: "the file cannot be written"},
        compiles=True,
        module="make.dbc",
    ),
)
