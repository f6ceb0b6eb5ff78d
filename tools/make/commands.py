"""Commands: new, dbc."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import WORD, Request


class _Dialects:
    """Names of drives, read when they are asked for: ours and those of packages of others."""

    def __iter__(self) -> Iterator[str]:
        from pcpc.drivers.machine import outside  # here, because they take time
        from pcpc.executive.rig.bus_keys import PROFILES

        yield from dict.fromkeys((*PROFILES, *(one.name for one in outside.additions("drives"))))


class NewRequest(Request):
    """A folder, and what is to be in it."""

    dir: Annotated[str | None, WORD, "DIR", "a new or empty folder; names the rig"] = None
    cart: Annotated[bool, "a pole on a cart in place of the motor"] = False
    bare: Annotated[bool, "one input, one output: for a plant of your own"] = False
    device: Annotated[bool, "also write the law as a device program"] = False
    drive: Annotated[
        str | None,
        "DIALECT",
        "also write the motor as a drive: %(choices)s",
        {"choices": _Dialects()},
    ] = None


class DbcRequest(Request):
    """A rig, and how its DBC file is written."""

    rig: Annotated[str, "RIG", "the rig's file or folder; needs no DBC file"]
    output: Annotated[str | None, "-o", "FILE", "default: the file that the rig names"] = None
    crc: Annotated[
        Literal[8, 16], "bits of the CRC in each cyclic frame; 16: AUTOSAR E2E profile 5"
    ] = 8


COMMANDS = (
    Command(
        "new",
        "write a first rig of your own: a DC motor, a pole on a cart, or a bare one",
        "pcpc new my-motor\npcpc new my-motor --device\n"
        "pcpc new my-motor --drive cia402\npcpc new --cart pole\n"
        "pcpc new --bare tanks",
        NewRequest,
        codes=codes(ENVIRONMENT="cannot be written"),
        module="make.new",
        first=True,
    ),
    Command(
        "dbc",
        "write a DBC file for a rig from its wiring",
        "pcpc dbc probe -o new.dbc",
        DbcRequest,
        codes=codes(ENVIRONMENT="cannot be written"),
        compiles=True,
        module="make.dbc",
    ),
)
