"""Commands: xcp, generate a2l."""

from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import NODE_CODES, OUTPUT_CODES, Command
from pcpc.tools.terminal.request import WORD, Request
from pcpc.tools.terminal.rooms import Room


class Ports(Request):
    """Where an XCP slave listens on UDP."""

    udp: Annotated[int | None, take.port, "PORT", "port of XCP on UDP; default: 5555, 0: any"] = (
        None
    )
    address: Annotated[str, "ADDRESS", "default: %(default)s"] = "127.0.0.1"


class XcpRequest(Request):
    """A node, and where it is served."""

    node: Annotated[str | None, WORD, "NODE", "executive, plant, RIG.plant; default: executive"] = (
        None
    )
    ports: Ports = Ports()
    tcp: Annotated[int | None, take.port, "PORT", "port of XCP on TCP; 0: any"] = None
    can: Annotated[bool, "XCP on CAN, on the node's bus"] = False


class A2lRequest(take.RigRequest):
    """A rig, one of its nodes, and where that is served."""

    node: Annotated[str, "NODE", "default: %(default)s"] = "executive"
    ports: Ports = Ports()
    output: Annotated[Path | None, "-o", "FILE", "default: RIG-NODE.a2l"] = None


class SlavesOfRun(Request):
    """The slaves beside a run: the rig's key `xcp`."""

    xcp: Annotated[
        None,
        "xcp={}".format,
        "udp:PORT",
        "serve XCP during the run, also tcp:PORT, can; default: %(const)s",
        {"nargs": "?", "action": "append", "dest": "set", "const": "udp:5555", "default": []},
    ] = None


class SlaveInC(Request):
    """The slave of a device in C."""

    xcp: Annotated[
        str | None,
        "ID,ID",
        "--device: an XCP slave on CAN, its two ids; default: %(const)s",
        {"nargs": "?", "const": "0x7E0,0x7E1"},
    ] = None


BESIDE_RUN = SlavesOfRun
BESIDE_C = SlaveInC
COMMANDS = (
    Command(
        "xcp",
        "a running node as an XCP slave",
        "pcpc xcp executive --udp 5555",
        XcpRequest,
        module="live.xcp.serve",
        codes=NODE_CODES,
    ),
)
PARTS_OF = {
    "generate": (
        Command(
            "a2l",
            "the variables of a rig as an A2L file",
            "pcpc generate a2l hull -o hull.a2l",
            A2lRequest,
            module="live.xcp.a2l_file",
            codes=OUTPUT_CODES,
        ),
    )
}
ROOM = Room("docs/howto/calibrate.md", "tests/tools/live/xcp/test_xcp_can_session.py", "xcp")
