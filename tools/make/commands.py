"""Commands: new, dbc."""

from pcpc.tools.terminal.command import Add, Command, codes


def new(add: Add) -> None:
    """Take a folder, and what is to be in it."""
    add("dir", nargs="?", metavar="DIR", help="a new or empty folder; names the rig")
    add("--cart", action="store_true", help="a pole on a cart in place of the motor")
    add("--bare", action="store_true", help="one input, one output: for a plant of your own")
    add(
        "--device",
        action="store_true",
        help="also write the law as a device program",
    )
    add(
        "--drive",
        choices=("cia402", "odrive", "mit", "moteus"),
        help="also write the motor as a drive: CiA 402, or a robot's, by its dialect",
    )


def dbc(add: Add) -> None:
    """Take a rig, and where to write."""
    add("rig", metavar="RIG", help="the rig's file or folder; needs no DBC file")
    add("-o", "--output", metavar="FILE", help="default: the file that the rig names")
    add(
        "--crc",
        type=int,
        choices=(8, 16),
        default=8,
        help="bits of the CRC in each cyclic frame; 16: AUTOSAR E2E profile 5",
    )


COMMANDS = (
    Command(
        "new",
        "write a first rig of your own: a DC motor, a pole on a cart, or a bare one",
        "pcpc new my-motor\npcpc new my-motor --device\n"
        "pcpc new my-motor --drive cia402\npcpc new --cart pole\n"
        "pcpc new --bare tanks",
        new,
        codes=codes(ENVIRONMENT="cannot be written"),
        module="make.new",
        first=True,
    ),
    Command(
        "dbc",
        "write a DBC file for a rig from its wiring",
        "pcpc dbc probe -o new.dbc",
        dbc,
        codes=codes(ENVIRONMENT="cannot be written"),
        compiles=True,
        module="make.dbc",
    ),
)
