"""Commands: slcan."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.rates import bits_per_s
from pcpc.tools.terminal.request import WORD, Request
from pcpc.tools.terminal.rooms import Room


class SlcanRequest(Request):
    """A bus, and the line: a port, or after -- a program."""

    bus: Annotated[str, "BUS", "vcan0, udp_multicast:GROUP[:PORT]"]
    port: Annotated[Path | None, WORD, "PORT", "serial line: /dev/ttyACM0"] = None
    baud: Annotated[int, take.positive, "N", "default: %(default)s"] = 115200
    bitrate: Annotated[
        int | None,
        bits_per_s,
        "RATE",
        "bit rate to set in the adapter: 500k, 1M; default: unchanged",
    ] = None
    data_bitrate: Annotated[int | None, bits_per_s, "RATE", "of CAN FD: 2M, 5M"] = None
    rest: Sequence[str] = ()


class InPlace(Request):
    """A device in the executive's place."""

    device: Annotated[
        Sequence[str] | None,
        "COMMAND",
        "record and judge a device in the executive's place; the rest of the line starts it, "
        "with {bus} for the bus; without COMMAND, wait for it",
        {"nargs": argparse.REMAINDER},
    ] = None


BESIDE_PLANT = InPlace
COMMANDS = (
    Command(
        "slcan",
        "connect an slcan device, on a serial line or in QEMU, to a bus",
        "pcpc slcan vcan0 /dev/ttyACM0\npcpc slcan vcan0 -- sh firmware/qemu.sh m7",
        SlcanRequest,
        notes="with a program, the exit code is the program's",
        rest="PROGRAM ...",
        module="make.device.slcan",
        codes=codes(OK="the serial line was closed", ENVIRONMENT="the bus cannot be used"),
    ),
)
ROOM = Room(
    "docs/device.md",
    "tests/tools/make/device",
    "run probe --device true",
    refused="no option --device",
)
