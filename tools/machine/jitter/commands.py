"""Commands: jitter."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes


def jitter(add: Add) -> None:
    """Take what cyclictest takes, and yardsticks."""
    add(
        "-i",
        "--interval",
        default="1000us",
        metavar="TIME",
        help="period, 50us to 1s; default: 1000us",
    )
    add(
        "-D",
        "--duration",
        default="10s",
        metavar="TIME",
        help="of all rounds of a loop; default: 10s",
    )
    add(
        "-p",
        "--priority",
        type=int,
        default=80,
        metavar="1..99",
        help="SCHED_FIFO priority, if allowed; plant: 10 less; default: 80",
    )
    add("-h", "--histogram", type=int, metavar="US", help="print cyclictest's histogram up to US")
    take.quiet(add, "-q")
    add(
        "-a",
        "--affinity",
        metavar="CPU[,CPU]",
        help="processors of executive and plant; other loops use the first",
    )
    add(
        "--bus",
        metavar="INTERFACE[:CHANNEL]",
        help="auto, vcan0, udp_multicast[:GROUP[:PORT]]; must be unused",
    )
    add("--against", metavar="NAME,...", help="compare with cyclictest, c, python")
    add("--rounds", type=int, metavar="N", help="parts of the duration; default: 1, --against: 5")
    add(
        "--limits",
        type=Path,
        reads=True,
        metavar="FILE",
        help="YAML file of limits; exit with 1 if one does not hold",
    )
    add("--json", type=Path, metavar="FILE", help="write all figures to this file")
    add("--plot", type=Path, metavar="FILE.png", help="draw the histograms of all loops")


COMMANDS = (
    Command(
        "jitter",
        "measure the timing of the loop, beside cyclictest and C",
        "pcpc jitter -i 1000us -D 60s -p 80 -h 400 --json=jitter.json\n"
        "pcpc jitter -D 25s --against cyclictest,c,python --plot jitter.png\n"
        "pcpc jitter -D 60s --limits machine.yaml    # wake: {99.9: 100us}",
        jitter,
        codes=codes(
            OK="measured, all limits held",
            NOT_MET="a limit does not hold, or was not judged",
            LOSS="the log is incomplete",
            ENVIRONMENT="",
            INTERRUPTED="",
        ),
        judges=True,
        own_h=True,
        module="machine.jitter.cli",
    ),
)
