"""Commands: jitter."""

from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command


def jitter(add: Add) -> None:
    """Take what cyclictest takes, and yardsticks."""
    add("-i", "--interval", default="1000us", metavar="TIME", help="period; 1000us; 50us to 1s")
    add("-D", "--duration", default="10s", metavar="TIME", help="of all rounds of a loop; 10s")
    add(
        "-p",
        "--priority",
        type=int,
        default=80,
        metavar="1..99",
        help="of SCHED_FIFO, where that is allowed; 80; the plant's is 10 less",
    )
    add("-h", "--histogram", type=int, metavar="US", help="cyclictest's histogram, up to US")
    take.quiet(add, "-q")
    add(
        "-a",
        "--affinity",
        metavar="CPU[,CPU]",
        help="processors of executive and plant; other loops: the first one",
    )
    add(
        "--bus",
        metavar="INTERFACE[:CHANNEL]",
        help="auto, vcan0, udp_multicast[:GROUP[:PORT]]; one that nobody else uses",
    )
    add("--against", metavar="NAME,...", help="compare with cyclictest, c, python")
    add("--rounds", type=int, metavar="N", help="parts of the duration; 5 with --against")
    add("--limits", type=Path, metavar="FILE", help="limits in YAML: 1 unless all hold")
    add("--json", type=Path, metavar="FILE", help="write all figures there")
    add("--plot", type=Path, metavar="FILE.png", help="draw the histograms of all loops")


COMMANDS = (
    Command(
        "jitter",
        "measure the timing of the loop, beside cyclictest and C",
        "pcpc jitter -i 1000us -D 60s -p 80 -h 400 --json=jitter.json\n"
        "pcpc jitter -D 25s --against cyclictest,c,python --plot jitter.png\n"
        "pcpc jitter -D 60s --limits machine.yaml    # wake: {99.9: 100us}",
        jitter,
        codes={
            Exit.OK: "measured, all limits held",
            Exit.NOT_MET: "a limit not held, or not judged",
            Exit.WRONG_INPUT: "",
            Exit.LOSS: "the log is not whole",
            Exit.ENVIRONMENT: "",
            Exit.INTERRUPTED: "",
        },
        judges=True,
        own_h=True,
        module="machine.jitter.cli",
    ),
)
