"""Commands: jitter."""

from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class JitterRequest(Request):
    """What cyclictest takes, and yardsticks."""

    interval: Annotated[str, "-i", "TIME", "period, 50us to 1s; default: 1000us"] = "1000us"
    duration: Annotated[str, "-D", "TIME", "of all rounds of a loop; default: 10s"] = "10s"
    priority: Annotated[
        int,
        "-p",
        "1..99",
        "SCHED_FIFO priority, if allowed; plant: 10 less; default: 80",
    ] = 80
    histogram: Annotated[int | None, "-h", "US", "print cyclictest's histogram up to US"] = None
    quiet: take.ShortQuiet = False
    affinity: Annotated[
        str | None,
        "-a",
        "CPU[,CPU]",
        "processors of executive and plant; other loops use the first",
    ] = None
    bus: Annotated[
        str | None,
        "INTERFACE[:CHANNEL]",
        "auto, vcan0, udp_multicast[:GROUP[:PORT]]; must be unused",
    ] = None
    against: Annotated[str | None, "NAME,...", "compare with cyclictest, c, python"] = None
    rounds: Annotated[int | None, "N", "parts of the duration; default: 1, --against: 5"] = None
    limits: Annotated[
        Path | None,
        "FILE",
        "YAML file of limits; exit with 1 if one does not hold",
        {"reads": True},
    ] = None
    json: Annotated[Path | None, "FILE", "write all figures to this file"] = None
    plot: Annotated[Path | None, "FILE.png", "draw the histograms of all loops"] = None


COMMANDS = (
    Command(
        "jitter",
        "measure the timing of the loop, beside cyclictest and C",
        "pcpc jitter -i 1000us -D 60s -p 80 -h 400 --json=jitter.json\n"
        "pcpc jitter -D 25s --against cyclictest,c,python --plot jitter.png\n"
        "pcpc jitter -D 60s --limits machine.yaml    # wake: {99.9: 100us}",
        JitterRequest,
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
ROOM = Room("docs/timing.md", "tests/tools/machine/test_jitter.py")
