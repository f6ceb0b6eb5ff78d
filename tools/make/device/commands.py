"""Commands: slcan."""

import argparse
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command
from pcpc.tools.terminal.rates import bits_per_s


def slcan(add: Add) -> None:
    """Take a bus, and the line: a port, or after -- a program."""
    add("bus", metavar="BUS", help="as --bus: vcan0, udp_multicast:GROUP[:PORT]")
    add("port", type=Path, nargs="?", metavar="PORT", help="a serial line: /dev/ttyACM0")
    add("--baud", type=take.positive, default=115200, metavar="N", help="default: %(default)s")
    add(
        "--bitrate",
        type=bits_per_s,
        metavar="RATE",
        help="that the adapter has to set: 500k, 1M; default: as it is",
    )


def in_place(add: Add) -> None:
    """Take a device in the executive's place."""
    add(
        "--device",
        nargs=argparse.REMAINDER,
        metavar="COMMAND",
        help="record and judge a device in the executive's place: the rest of the line starts it, "
        "{bus} is the bus; without one it is waited for",
    )


BESIDE_PLANT = in_place
COMMANDS = (
    Command(
        "slcan",
        "put a device on a bus that speaks slcan on a serial line, or in QEMU",
        "pcpc slcan vcan0 /dev/ttyACM0\npcpc slcan vcan0 -- sh firmware/qemu.sh m7",
        slcan,
        notes="of a program the exit code is its own",
        rest="PROGRAM ...",
        module="make.device.slcan",
        codes={Exit.OK: "the line has ended", Exit.WRONG_INPUT: "", Exit.ENVIRONMENT: "the bus"},
    ),
)
