"""Commands: margin."""

import argparse
from collections.abc import Sequence
from typing import Annotated, Literal

from pcpc.drivers.errors import UserError
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.rates import frequency
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room

Method = Literal["both", "linearised", "measured"]
SETTLE_S = 4.0
_PERIODS = 4000  # of the rate in the period of the lowest line


class Question(Request):
    """How a loop is looked at; the words are those of `pcpc.margin`."""

    loop: Annotated[
        str | None, "SIGNAL", "the command signal that closes the loop; default: the first"
    ] = None
    at_s: Annotated[
        float,
        take.time,
        "--at",
        "TIME",
        "hold the reference of this time of the run; default: 0 s",
    ] = 0.0
    settle_s: Annotated[
        float, take.duration, "--settle", "TIME", "time to come to rest; default: 4s"
    ] = SETTLE_S
    method: Annotated[Method, "default: %(default)s"] = "both"
    amplitude: Annotated[
        float | None, "A", "injected amplitude, in the signal's unit; default: automatic"
    ] = None
    lowest_hz: Annotated[
        float | None, frequency, "--lowest", "F", "lowest frequency; default: rate/4000"
    ] = None
    seed: Annotated[int, take.seed, "N", "seed of the phases; default: %(default)s"] = 1

    def lowest(self, rate: float) -> float:
        """Return the lowest frequency, Hz, of a rig of a rate."""
        return rate / _PERIODS if self.lowest_hz is None else self.lowest_hz

    def check(self, rate: float) -> None:
        """Raise UserError for what no rig of a rate can be asked."""
        least, most, lowest = rate / 1e6, rate / 8.0, self.lowest(rate)
        if self.method not in ("both", "linearised", "measured"):
            raise UserError(f"method {self.method}: expected both, linearised or measured")
        if not 0.0 <= self.at_s <= 1e6:
            raise UserError(f"--at {self.at_s:g} s: expected a time of the run, 0 or later")
        if self.amplitude is not None and not 0.0 < self.amplitude < 1e300:
            raise UserError(f"--amplitude {self.amplitude:g}: expected a number above 0")
        if not 1.0 / rate <= self.settle_s <= 1e4:
            what = f"expected {1.0 / rate:g} s to 10000 s"
            raise UserError(f"--settle {self.settle_s:g} s: {what}")
        if not least <= lowest <= most:
            what = f"expected {least:g} to {most:g} Hz, an eighth of the rate"
            raise UserError(f"--lowest {lowest:g} Hz: {what}")
        if self.seed < 0:
            raise UserError(f"--seed {self.seed}: expected 0 or a whole number above it")


def numbers(text: str) -> list[float]:
    """Return numbers above 0, with commas between. ArgumentTypeError: not such numbers."""
    try:
        found = [float(one) for one in text.split(",")]
    except ValueError:
        found = [0.0]
    if not all(0.0 < one < 1e6 for one in found):
        raise argparse.ArgumentTypeError(f"expected numbers above 0 like 1,1.5,2, got {text!r}")
    return found


class MarginRequest(take.RigRequest):
    """The margins of a rig's loop, or where a limit cycle begins in it."""

    question: Question = Question()
    output: Annotated[
        str | None, "-o", "DIR", "folder for margin.json, bode.png and nyquist.png"
    ] = None
    limit_cycle: Annotated[
        str | None, "GAIN", "predict the factor of this setting where a limit cycle begins"
    ] = None
    linear: Annotated[
        Sequence[str],
        "SETTING",
        "--limit-cycle: makes it linear, as --set; default: its linear.yaml",
    ] = ()
    grown: Annotated[
        Sequence[str] | None,
        "--with",
        "NAME",
        "--limit-cycle: nonlinearities to restore; default: all but noise",
    ] = None
    factors: Annotated[
        Sequence[float] | None, numbers, "F,...", "--limit-cycle: also run at these factors"
    ] = None
    json: take.Json = False


COMMANDS = (
    Command(
        "margin",
        "compute and measure the stability margins of a rig's loop",
        "pcpc margin sin0.5 --controller pd\n"
        "pcpc margin sin0.5 --at 500ms --amplitude 0.2 -o margins",
        MarginRequest,
        compiles=True,
        module="study.margin.cli",
        codes=codes(ENVIRONMENT="a package is missing", INTERRUPTED=""),
    ),
)
ROOM = Room(
    "docs/margin.md",
    "tests/tools/study/margin/test_margin_words.py",
    "margin probe",
    needed_by=("study/book/rivals.py",),
)
