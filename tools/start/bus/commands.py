"""Commands: bus."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes
from pcpc.tools.terminal.rates import bits_per_s, hz


def bus(add: Add) -> None:
    """Take a rig, and the bus that it is to fit; or two buses to make one of."""
    add(
        "words",
        nargs="+",
        metavar="RIG | emulate A B",
        help="a rig's name or file; emulate: two buses, as vcan0 vcan1, udp_multicast:GROUP:PORT",
    )
    take.settings(add, "change a value of the rig, as realtime.plant.phase=0.4")
    add(
        "--bitrate",
        type=bits_per_s,
        metavar="RATE",
        help="500k, 1M; default: the rig's bus.bitrate, or 1M",
    )
    add(
        "--data-bitrate",
        type=bits_per_s,
        metavar="RATE",
        help="CAN FD: data rate, 2M, 5M; emulate: none is carried without",
    )
    add("--rate", type=hz, metavar="RATE", help="cycle rate: 2kHz; default: the rig's")
    add(
        "--jitter",
        type=take.seconds("--jitter"),
        default=0.0,
        metavar="TIME",
        help="delay from a node's cycle to its frames: 100us; default: 0",
    )
    add(
        "--any-phase",
        action="store_true",
        help="the nodes' clocks drift, as on two machines",
    )
    add(
        "--in-order",
        action="store_true",
        help="a node sends in its loop's order (SocketCAN), not by priority",
    )
    add(
        "--queue",
        type=take.positive,
        default=64,
        metavar="N",
        help="emulate: most frames that wait on a side; default: %(default)s",
    )
    add(
        "--errors",
        metavar="p=P,...",
        help="emulate: bit error rate; burst=N transmissions; seed=N",
    )
    add(
        "--for",
        type=take.duration,
        dest="for_s",
        metavar="DURATION",
        help="emulate: stop after this time; default: at Ctrl-C",
    )
    add(
        "--error-every",
        type=take.seconds("--error-every"),
        default=0.0,
        metavar="TIME",
        help="shortest time between bus errors: 10ms; default: none",
    )
    add("--plot", type=Path, metavar="FILE.png", help="draw the cycle with the most frames")
    take.quiet(add)
    take.json(add)


COMMANDS = (
    Command(
        "bus",
        "print bus load and worst-case response time of each frame",
        "pcpc bus hull\npcpc bus hull --rate 2kHz --bitrate 1M --data-bitrate 4M\n"
        "pcpc bus emulate vcan0 vcan1 --bitrate 500k --errors p=1e-5,seed=7",
        bus,
        codes=codes(
            OK="all frames are in time",
            NOT_MET="a frame is late",
            LOSS="emulate: a frame was lost",
            ENVIRONMENT="emulate: a bus cannot be used",
            INTERRUPTED="emulate",
        ),
        module="start.bus.cli",
    ),
)
