"""Commands: xcp, a2l."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import NODE_CODES, OUTPUT_CODES, Add, Command


def _ports(add: Add) -> None:
    add("--udp", type=take.port, metavar="PORT", help="port of XCP on UDP; default: 5555, 0: any")
    add("--address", metavar="ADDRESS", default="127.0.0.1", help="default: %(default)s")


def xcp(add: Add) -> None:
    """Take a node, and where it is served."""
    add("node", nargs="?", metavar="NODE", help="executive, plant, RIG.plant; default: executive")
    _ports(add)
    add("--tcp", type=take.port, metavar="PORT", help="port of XCP on TCP; 0: any")
    add("--can", action="store_true", help="XCP on CAN, on the node's bus")


def a2l(add: Add) -> None:
    """Take a rig and one of its nodes."""
    take.rig(add)
    add("--node", default="executive", metavar="NODE", help="default: %(default)s")
    _ports(add)
    add("-o", "--output", type=Path, metavar="FILE", help="default: RIG-NODE.a2l")


def xcp_options(add: Add) -> None:
    """Take the slaves beside a run: the rig's key `xcp`."""
    add(
        "--xcp",
        nargs="?",
        action="append",
        dest="set",
        const="udp:5555",
        default=[],
        type="xcp={}".format,
        metavar="udp:PORT",
        help="serve XCP during the run, also tcp:PORT, can; default: %(const)s",
    )


def in_c(add: Add) -> None:
    """Take the slave of a device in C."""
    add(
        "--xcp",
        nargs="?",
        const="0x7E0,0x7E1",
        metavar="ID,ID",
        help="--device: an XCP slave on CAN, its two ids; default: %(const)s",
    )


BESIDE_RUN = xcp_options
BESIDE_C = in_c
COMMANDS = (
    Command(
        "xcp",
        "a running node as an XCP slave",
        "pcpc xcp executive --udp 5555",
        xcp,
        module="live.xcp.serve",
        codes=NODE_CODES,
    ),
    Command(
        "a2l",
        "the variables of a rig as an A2L file",
        "pcpc a2l hull -o hull.a2l",
        a2l,
        module="live.xcp.a2l_file",
        codes=OUTPUT_CODES,
    ),
)
