"""The options of `python -m pcpc.tools.dev.evidence`, and of `.evidence.soak`."""

import argparse
import math
from collections.abc import Sequence
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import WORD, Request

PARTS = ("matrix", "residual", "frames", "envelope", "alarms", "mutants", "kills")  # in their order
_MOST_H = 87_600.0  # ten years


def _hours(text: str) -> float:
    """Return a number of hours above 0."""
    try:
        found = float(text)
    except ValueError:
        found = math.nan
    if not 0.0 < found <= _MOST_H:
        what = f"expected hours, above 0 and at most {_MOST_H:g}, got {text!r}"
        raise argparse.ArgumentTypeError(what)
    return found


class EvidenceRequest(Request):
    """The parts of the evidence, how much of each, and where it goes."""

    parts: Annotated[Sequence[str], WORD, "PART", f"{', '.join(PARTS)}; all"] = ()
    runs: Annotated[int, take.positive, "N", "runs of each fault; default: 3000"] = 3000
    hours: Annotated[float, _hours, "H", "hours without a fault; default: 100"] = 100.0
    frames: Annotated[int, take.positive, "N", "damaged frames; default: 10^6"] = 1_000_000
    laws: Annotated[int, take.positive, "N", "random laws; default: 100,000"] = 100_000
    kills: Annotated[int, take.positive, "N", "disturbed processes; default: 100"] = 100
    seed: Annotated[int, take.seed, "N", "first seed; default: 1"] = 1
    jobs: Annotated[int | None, take.positive, "-j", "N", "processes; default: one a processor"] = (
        None
    )
    output: Annotated[str, "-o", "FOLDER", "folder for faults.md and faults.json"] = "evidence"
    quiet: take.ShortQuiet = False


class SoakRequest(Request):
    """A rig, and for how long it runs."""

    rig: Annotated[str, "RIG", "a rig's name (pcpc rigs) or file"]
    hours: Annotated[float, _hours, "H", "default: %(default)s"] = 1.0
    each_s: Annotated[
        float,
        take.duration,
        "--each",
        "DURATION",
        "duration of a run on a clock; default: 10min",
    ] = 600.0
    seed: Annotated[int, take.seed, "N", "seed of tunings and faults; default: %(default)s"] = 1
    json: Annotated[bool, "print JSON, a line a run"] = False
    quiet: take.ShortQuiet = False


COMMAND = Command(
    "pcpc.tools.dev.evidence",
    "inject every fault and count what detects it",
    "python -m pcpc.tools.dev.evidence\npython -m pcpc.tools.dev.evidence mutants kills --kills 32",
    EvidenceRequest,
    compiles=True,
    module="dev.evidence.native_process",
    codes=codes(
        OK="all figures as stated",
        NOT_MET="a figure is not as stated",
        ENVIRONMENT="cannot be written",
        INTERRUPTED="",
    ),
)
SOAK = Command(
    "pcpc.tools.dev.evidence.soak",
    "run with random tunings and faults for hours; check each log",
    "python -m pcpc.tools.dev.evidence.soak hull --hours 8",
    SoakRequest,
    compiles=True,
    module="dev.evidence.soak",
    codes=codes(
        OK="no problem",
        NOT_MET="a log has a problem",
        INTERRUPTED="",
    ),
)
