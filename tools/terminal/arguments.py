"""What several commands of `pcpc` take; imports nothing that takes time."""

import argparse
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Annotated, Any

from pcpc.drivers.errors import UserError
from pcpc.executive.durations import duration_ns, duration_s
from pcpc.tools.terminal.option_notes import need_value
from pcpc.tools.terminal.request import Request

MOST_SEED = 2**53  # which a float holds, as JSON and logs have numbers
_LONGEST_S = 1e9  # 30 years: in ns behind any wall time it is an int64
BUSES = "auto, vcan0, udp_multicast[:GROUP[:PORT]], any python-can one"


class Standby(argparse.Action):
    """An option that is a setting of the rig in other words."""

    def __call__(
        self, parser: argparse.ArgumentParser, options: argparse.Namespace, text: Any, *_: Any
    ) -> None:
        """Append it to the settings."""
        need_value(parser, "--standby", text)
        if not text.strip(", "):
            parser.error(f"--standby {text!r}: names no controller")
        options.set = [*options.set, f"standby=[{text}]"]


Json = Annotated[bool, "print JSON"]
Quiet = Annotated[bool, "no progress"]
ShortQuiet = Annotated[bool, "-q", "no progress"]
Log = Annotated[str, "LOG", "log file, run folder or latest"]


class RigRequest(Request):
    """A rig, and what is changed in it."""

    rig: Annotated[str, "RIG", "a rig's name (pcpc rigs), file or folder, or a run in progress"]
    controller: Annotated[str | None, "NAME", "use this controller; default: the rig's"] = None
    standby: Annotated[
        None,
        Standby,
        "NAME[,NAME]",
        "controllers that can take over with `pcpc operate handover`",
    ] = None
    set: Annotated[
        Sequence[str],
        "NAME=VALUE",
        "change a value, as controller.kv_Nms_rad=130; @FILE: from pcpc save",
    ] = ()


class CodeOfLaws(Request):
    """Whose code of a log may run."""

    trust: Annotated[bool, "run the Python in the log: its laws, its evaluation"] = False
    law: Annotated[
        Sequence[str],
        "FILE",
        "a Python file of the run that has moved, or a file it reads",
        {"reads": True},
    ] = ()
    rig: Annotated[str | None, "RIG", "the rig file that the run's files lie beside now"] = None
    fmu: Annotated[
        Sequence[str],
        "FILE",
        "run this FMU of the run (native code, never in a log)",
        {"reads": True},
    ] = ()


class RunFolder(Request):
    """Where a run is kept, and how it is told and judged."""

    output: Annotated[str | None, "-o", "DIR", "run folder; default: runs/<UTC time>-<rig>"] = None
    json: Json = False
    quiet: Annotated[bool, "print only problems and verdict"] = False
    no_figure: Annotated[bool, "do not draw figure.png"] = False
    judge: Annotated[bool, "exit with 1 if a limit was not judged, or there is none"] = False


def duration(text: str) -> float:
    """Return a duration such as 500ms, 10s, 2min in s. ArgumentTypeError: not a duration."""
    try:
        return duration_s(text, unit="")
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def time(text: str) -> float:
    """Return the s of a time of a run: 0, 1.5, 500ms. ArgumentTypeError: not a time."""
    with suppress(ValueError):
        found_s = float(duration_ns(text, unit="s", zero=True) / 10**9)
        if found_s <= _LONGEST_S:
            return found_s
    raise argparse.ArgumentTypeError(f"{text}: not a time; expected like 0, 1.5, 500ms")


def seconds(option: str, zero: bool = False) -> Callable[[str], float]:
    """Return what makes seconds of a duration that `option` gives; UserError."""

    def from_text(text: str) -> float:
        try:
            return float(duration_ns(text, zero=zero) / 10**9)
        except ValueError as error:
            raise UserError(f"{option} {error}") from None

    return from_text


def seed(text: str) -> int:
    """Return the seed of random numbers. ArgumentTypeError: not a seed."""
    if not text.isdecimal() or int(text) > MOST_SEED:
        what = f"expected a whole number from 0 to {MOST_SEED}, got {text!r}"
        raise argparse.ArgumentTypeError(what)
    return int(text)


def port(text: str) -> int:
    """Return a port; 0: any that is free. ArgumentTypeError: not a port."""
    if not text.isdecimal() or int(text) > 65535:
        what = f"expected a port, 0 to 65535, 0 for any that is free, got {text!r}"
        raise argparse.ArgumentTypeError(what)
    return int(text)


def positive(text: str) -> int:
    """Return a whole number above 0. ArgumentTypeError: not such a number."""
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"expected a positive whole number, got {text!r}")
    return int(text)
