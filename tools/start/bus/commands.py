"""Commands: bus."""

from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command
from pcpc.tools.terminal.rates import bits_per_s, hz


def bus(add: Add) -> None:
    """Take a rig, and the bus that it is to fit; or two buses to make one of."""
    add(
        "words",
        nargs="+",
        metavar="RIG | emulate A B",
        help="name of a rig (pcpc rigs), or its file; emulate: two buses, as vcan0 vcan1, "
        "udp_multicast:GROUP:PORT",
    )
    take.settings(add, "any value of the rig, as realtime.plant.phase=0.4")
    add(
        "--bitrate",
        type=bits_per_s,
        metavar="RATE",
        help="500k, 1M; default: the rig's bus.bitrate, else 1M",
    )
    add(
        "--data-bitrate",
        type=bits_per_s,
        metavar="RATE",
        help="as CAN FD frames that switch to this rate: 2M, 5M",
    )
    add("--rate", type=hz, metavar="RATE", help="cycles a second, instead of the rig's: 2kHz")
    add(
        "--jitter",
        type=take.seconds("--jitter"),
        default=0.0,
        metavar="TIME",
        help="from a node's cycle to its frames: waking, work; 100us; default 0",
    )
    add(
        "--any-phase",
        action="store_true",
        help="nodes on clocks of their own, as two machines: their phases drift",
    )
    add(
        "--in-order",
        action="store_true",
        help="a node sends in its loop's order, as SocketCAN; default: by priority",
    )
    add(
        "--queue",
        type=take.positive,
        default=64,
        metavar="N",
        help="emulate: frames that wait on a side, no more; default: %(default)s",
    )
    add(
        "--errors",
        metavar="p=P,...",
        help="emulate: bit error rate p; burst=N transmissions in a row; seed=N",
    )
    add(
        "--for",
        type=take.duration,
        dest="for_s",
        metavar="DURATION",
        help="emulate: end after it; default: at Ctrl-C",
    )
    add(
        "--error-every",
        type=take.seconds("--error-every"),
        default=0.0,
        metavar="TIME",
        help="a bus error at most this often: 10ms; default none",
    )
    add("--plot", type=Path, metavar="FILE.png", help="draw the fullest cycle of the bus")
    take.quiet(add)
    take.json(add)


COMMANDS = (
    Command(
        "bus",
        "tell the load of its bus and when each frame is there in the worst case",
        "pcpc bus hull\npcpc bus hull --rate 2kHz --bitrate 1M --data-bitrate 4M\n"
        "pcpc bus emulate vcan0 vcan1 --bitrate 500k --errors p=1e-5,seed=7",
        bus,
        codes={
            Exit.OK: "it fits",
            Exit.NOT_MET: "a frame is late",
            Exit.WRONG_INPUT: "",
            Exit.LOSS: "emulate: a frame was lost",
            Exit.ENVIRONMENT: "emulate: a bus",
            Exit.INTERRUPTED: "emulate",
        },
        module="start.bus.cli",
    ),
)
