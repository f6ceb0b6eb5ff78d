"""What several commands of `pcpc` take; imports nothing that takes time."""

import argparse
from collections.abc import Callable
from typing import Any

from pcpc.drivers.errors import UserError
from pcpc.executive.durations import duration_ns, duration_s
from pcpc.executive.rig.roles import ROLES
from pcpc.tools.terminal.command import Add
from pcpc.tools.terminal.option_notes import need_value
from pcpc.tools.terminal.rooms import offers

MOST_SEED = 2**53  # which a float holds, as JSON and logs have numbers
BUSES = "auto, vcan0, udp_multicast[:GROUP[:PORT]], any python-can one"


def log(add: Add, **more: Any) -> None:
    """Take a log."""
    add("log", metavar="LOG", help="log file, run folder or latest", **more)


def several(add: Add, name: str, metavar: str, help: str, **more: Any) -> None:
    """Take an option that can be given several times."""
    add(name, action="append", default=[], metavar=metavar, help=help, **more)


def json(add: Add, help: str = "print JSON") -> None:
    """Take whether to print JSON."""
    add("--json", action="store_true", help=help)


def quiet(add: Add, *short: str) -> None:
    """Take whether to show progress."""
    add(*short, "--quiet", action="store_true", help="no progress")


def settings(add: Add, help: str) -> None:
    """Take settings of a rig."""
    several(add, "--set", "NAME=VALUE", help)


def moment(add: Add, help: str) -> None:
    """Take a cycle of a log."""
    add("--cycle", type=int, metavar="N", help=help)
    add("--time", type=float, metavar="S", help="the same as a time of the run, s")


def rig(add: Add) -> None:
    """Take a rig and what is changed in it."""
    add(
        "rig",
        metavar="RIG",
        help="a rig's name (pcpc rigs), file or folder, or a run in progress",
    )
    add("--controller", metavar="NAME", help="use this controller; default: the rig's")
    add(
        "--standby",
        action=_Standby,
        metavar="NAME[,NAME]",
        help="controllers that can take over with `pcpc handover`",
    )
    settings(add, "change a value, as controller.kv_Nms_rad=130; @FILE: from pcpc save")


class _Standby(argparse.Action):
    """An option that is a setting of the rig in other words."""

    def __call__(
        self, parser: argparse.ArgumentParser, options: argparse.Namespace, text: Any, *_: Any
    ) -> None:
        """Append it to the settings."""
        need_value(parser, "--standby", text)
        if not text.strip(", "):
            parser.error(f"--standby {text!r}: names no controller")
        options.set = [*options.set, f"standby=[{text}]"]


def run(add: Add) -> None:
    """Take a rig, and how it runs on a bus."""
    rig(add)
    add(
        "--pacing",
        choices=("real", "sync", "lockstep"),
        help="real: own clocks; sync: the plant follows SYNC; lockstep: no clock",
    )
    add("--bus", metavar="INTERFACE[:CHANNEL]", help=BUSES)
    run_folder(add)
    for more in offers("BESIDE_RUN"):
        more(add)


def run_folder(add: Add) -> None:
    """Take where a run is kept, and how it is told and judged."""
    add("-o", "--output", metavar="DIR", help="run folder; default: runs/<UTC time>-<rig>")
    json(add, "print JSON")
    add("--quiet", action="store_true", help="print only problems and verdict")
    add("--no-figure", action="store_true", help="do not draw figure.png")
    add(
        "--judge",
        action="store_true",
        help="exit with 1 if a limit was not judged, or there is none",
    )


def node(add: Add, help: str = "only this node; default: all", *more: str) -> None:
    """Take which node of a log is meant, or one of `more`."""
    add("--node", metavar="NODE", choices=(*ROLES, *more, "all"), default="all", help=help)


def code_of_laws(add: Add) -> None:
    """Take whose code of a log may run."""
    add(
        "--trust",
        action="store_true",
        help="run the Python in the log: its laws, its evaluation",
    )
    several(
        add,
        "--law",
        "FILE",
        "a Python file of the run that has moved, or a file it reads",
        reads=True,
    )
    add("--rig", metavar="RIG", help="the rig file that the run's files lie beside now")
    several(
        add,
        "--fmu",
        "FILE",
        "run this FMU of the run (native code, never in a log)",
        reads=True,
    )


def duration(text: str) -> float:
    """Return a duration such as 500ms, 10s, 2min in s. ArgumentTypeError: not a duration."""
    try:
        return duration_s(text, unit="")
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


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
