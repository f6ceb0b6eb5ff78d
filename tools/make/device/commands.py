"""Commands: slcan."""

import argparse
from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes
from pcpc.tools.terminal.rates import bits_per_s


def slcan(add: Add) -> None:
    """Take a bus, and the line: a port, or after -- a program."""
    add("bus", metavar="BUS", help="vcan0, udp_multicast:GROUP[:PORT]")
    add("port", type=Path, nargs="?", metavar="PORT", help="serial line: /dev/ttyACM0")
    add("--baud", type=take.positive, default=115200, metavar="N", help="default: %(default)s")
    add(
        "--bitrate",
        type=bits_per_s,
        metavar="RATE",
        help="bit rate to set in the adapter: 500k, 1M; default: unchanged",
    )
    add("--data-bitrate", type=bits_per_s, metavar="RATE", help="of CAN FD: 2M, 5M")


def in_place(add: Add) -> None:
    """Take a device in the executive's place."""
    add(
        "--device",
        nargs=argparse.REMAINDER,
        metavar="COMMAND",
        help="record and judge a device in the executive's place; the rest of the line starts it, "
        "with {bus} for the bus; without COMMAND, wait for it",
    )


BESIDE_PLANT = in_place
COMMANDS = (
    Command(
        "slcan",
        "connect an slcan device, on a serial line or in QEMU, to a bus",
        "pcpc slcan vcan0 /dev/ttyACM0\npcpc slcan vcan0 -- sh firmware/qemu.sh m7",
        slcan,
        notes="with a program, the exit code is the program's",
        rest="PROGRAM ...",
        module="make.device.slcan",
        codes=codes(OK="the serial line was closed", ENVIRONMENT="the bus cannot be used"),
    ),
)
