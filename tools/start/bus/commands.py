"""Commands: bus."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.rates import bits_per_s, hz
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room

InOrder = Annotated[bool, "a node sends in its loop's order (SocketCAN), not by priority"]


class BusLoadRequest(Request):
    """A rig, and the bus that it is to fit."""

    rig: Annotated[str, "RIG", "a rig's name (pcpc rigs), or its file"]
    set: Annotated[
        Sequence[str], "NAME=VALUE", "change a value of the rig, as realtime.plant.phase=0.4"
    ] = ()
    bitrate: Annotated[
        int | None, bits_per_s, "RATE", "500k, 1M; default: the rig's bus.bitrate, or 1M"
    ] = None
    data_bitrate: Annotated[int | None, bits_per_s, "RATE", "CAN FD: data rate, 2M, 5M"] = None
    rate_hz: Annotated[
        float | None, hz, "--rate", "RATE", "cycle rate: 2kHz; default: the rig's"
    ] = None
    jitter_s: Annotated[
        float,
        take.seconds("--jitter"),
        "--jitter",
        "TIME",
        "delay from a node's cycle to its frames: 100us; default: 0",
    ] = 0.0
    any_phase: Annotated[bool, "the nodes' clocks drift, as on two machines"] = False
    in_order: InOrder = False
    error_every_s: Annotated[
        float,
        take.seconds("--error-every"),
        "--error-every",
        "TIME",
        "shortest time between bus errors: 10ms; default: none",
    ] = 0.0
    plot: Annotated[Path | None, "FILE.png", "draw the cycle with the most frames"] = None
    quiet: take.Quiet = False
    json: take.Json = False


class EmulateRequest(Request):
    """Two buses to make one of, and what that is like."""

    a: Annotated[str, "CHANNEL", "vcan0, udp_multicast:GROUP:PORT"]
    b: Annotated[str, "CHANNEL", "another one"]
    bitrate: Annotated[int | None, bits_per_s, "RATE", "500k, 1M; default: 1M"] = None
    data_bitrate: Annotated[
        int | None, bits_per_s, "RATE", "CAN FD: data rate, 2M, 5M; none is carried without"
    ] = None
    bitrate_b: Annotated[int | None, bits_per_s, "RATE", "of B, where it is another one"] = None
    in_order: InOrder = False
    queue: Annotated[
        int, take.positive, "N", "most frames that wait on a side; default: %(default)s"
    ] = 64
    errors: Annotated[str | None, "p=P,...", "bit error rate; burst=N transmissions; seed=N"] = None
    for_s: Annotated[
        float | None,
        take.duration,
        "--for",
        "DURATION",
        "stop after this time; default: at Ctrl-C",
    ] = None
    quiet: take.Quiet = False
    json: take.Json = False


COMMANDS = (
    Command(
        "bus",
        "print bus load and worst-case response time of each frame",
        "pcpc bus hull\npcpc bus hull --rate 2kHz --bitrate 1M --data-bitrate 4M",
        BusLoadRequest,
        codes=codes(OK="all frames are in time", NOT_MET="a frame is late"),
        module="start.bus.cli",
    ),
    Command(
        "bus emulate",
        "make one CAN line with a bit rate and errors of two channels",
        "pcpc bus emulate vcan0 vcan1 --bitrate 500k --errors p=1e-5,seed=7",
        EmulateRequest,
        codes=codes(LOSS="a frame was lost", ENVIRONMENT="a bus cannot be used", INTERRUPTED=""),
        module="start.bus.emulate",
    ),
)
ROOM = Room("docs/howto/bus.md", "tests/tools/start/test_bus_load.py")
