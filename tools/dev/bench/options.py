"""The options of `python -m pcpc.tools.dev.bench`."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import WORD, Request

MOST_ROUNDS = 10_000
_SUITES = {  # by their modules, one of which may go with what it measures
    "wake": "how late the executive wakes, against cyclictest and C",
    "cycle": "one cycle of the executive, in memory and on a bus, against a device in C",
    "frame": "one frame sent and received against C and python-can",
    "codec": "packing and unpacking of all frames of the DBC against cantools and C",
    "recorder": "the recorder's throughput against mcap, its effect on the loop",
    "simulate": "a virtual run against C and scipy",
    "batch": "runs in lanes against C and scipy, two threads against one",
    "host": "lateness with the page of `pcpc host` and its clients against without",
    "startup": "the time from command to first cycle, warm and cold",
}
NEEDS = {  # yardsticks that a suite cannot do without, where C is not the only one
    "recorder": (), "host": (), "startup": (), "simulate": ("cc", "scipy"),
    "batch": ("cc", "scipy"),
}  # fmt: skip
SUITES = {
    name: text for name, text in _SUITES.items() if Path(__file__).with_name(f"{name}.py").is_file()
}


def _rounds(text: str) -> int:
    """Return a number of rounds that ends this week."""
    if (count := take.positive(text)) > MOST_ROUNDS:
        raise argparse.ArgumentTypeError(f"expected at most {MOST_ROUNDS}, got {text!r}")
    return count


class BenchRequest(Request):
    """Suites, and how they are measured."""

    names: Annotated[
        Sequence[str], WORD, "NAME", "suites; default: all but batch, rate, startup"
    ] = ()
    rounds: Annotated[int, _rounds, "N", "default: 15"] = 15
    json: Annotated[Path | None, "FILE", "write the ratios to this file too"] = None
    quiet: take.Quiet = False


COMMAND = Command(
    "pcpc.tools.dev.bench",
    "measure ratios against C and others, interleaved in one run",
    "python -m pcpc.tools.dev.bench cycle --json cycle.json",
    BenchRequest,
    codes=codes(ENVIRONMENT="a program to compare with is missing", INTERRUPTED=""),
    notes="suites:\n" + "\n".join(f"  {name:9}{text}" for name, text in SUITES.items()),
    compiles=True,
    module="dev.bench.cli",
)
