"""What the subcommands of `pcpc` take, but for those that bring their own arguments."""

import argparse
from collections.abc import Mapping
from typing import Any, NoReturn

from pcpc.tools import screen

USAGE = 2
CODES = """exit code: 0 ok, 1 expectation not met, 2 wrong input, 3 loss, 4 environment,
  5 safety stop, 130 Ctrl-C"""
_BUSES = "auto, vcan0, udp_multicast[:GROUP[:PORT]], any python-can one"
_RUNS = {
    "run": "pcpc run hull",
    "exec": "pcpc exec hull --bus vcan0",
    "plant": "pcpc plant hull --bus vcan0",
    "local": "pcpc local telerobot-u1 --bus vcan0",
    "simulate": "pcpc simulate hull --controller pid --set barrel.gap_rad=0.003",
}
_TABLE = {
    "list": "pcpc list 'controller.*'",
    "get": "pcpc get controller.e_rad barrel.theta_rad",
    "set": "pcpc set controller.kv_Nms_rad=120 controller.lam_per_s=15",
    "watch": "pcpc watch 'controller.*' --every 500ms",
    "lock": "pcpc lock tune",
}
_NAMES: dict[str, tuple[str, str | int]] = {
    "list": ("NAME", "*"),
    "set": ("NAME=VALUE", "+"),
    "lock": ("none|tune|all", 1),
}


class _Refused(argparse.Action):
    """An option of the other commands that would have no effect here."""

    def __call__(self, parser: argparse.ArgumentParser, *given: Any) -> NoReturn:
        parser.error(f"{given[-1]}: not in virtual time; `pcpc run` has it")


def add_all(commands: Any, texts: Mapping[str, str]) -> None:
    """Register the subcommands; `texts`: what each does, by its name."""
    _add_rigs(commands, texts)
    _add_runs(commands, texts)
    _add_table(commands, texts)
    one = _command(commands, "check", texts, "pcpc check hull")
    _add_rig(one)
    _add_json(one)
    _add_json(_command(commands, "doctor", texts, "pcpc doctor"))
    _add_experiment(commands, texts)
    _command(commands, "vm", texts, "pcpc vm -- candump vcan0")


def _command(
    commands: Any, name: str, texts: Mapping[str, str], example: str
) -> argparse.ArgumentParser:
    found: argparse.ArgumentParser = commands.add_parser(
        name, help=texts[name], description=texts[name], epilog=f"example: {example}\n{CODES}",
        formatter_class=screen.Help,
    )  # fmt: skip
    return found


def _add_json(parser: argparse.ArgumentParser, help: str = "print one JSON object") -> None:
    parser.add_argument("--json", action="store_true", help=help)


def _add_rig(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("rig", metavar="RIG", help="name of a rig (pcpc rigs), or its file")
    parser.add_argument("--controller", metavar="NAME", help="controller, instead of the rig's")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any value of the rig or a block, as controller.kv_Nms_rad=130",
    )


def _add_rigs(commands: Any, texts: Mapping[str, str]) -> None:
    one = _command(commands, "rigs", texts, "pcpc rigs atb1000 'friction-*'")
    one.add_argument("names", nargs="*", metavar="NAME", help="only these rigs or plants; * ? []")
    _add_json(one, "print one JSON list")


def _add_runs(commands: Any, texts: Mapping[str, str]) -> None:
    for name, example in _RUNS.items():
        one = _command(commands, name, texts, example)
        _add_rig(one)
        one.add_argument(
            "-o", "--output", metavar="DIR", help="run folder, instead of runs/<UTC time>-<rig>"
        )
        if name == "simulate":
            one.add_argument("--bus", "--pacing", action=_Refused, help=argparse.SUPPRESS)
        else:
            one.add_argument(
                "--pacing", choices=("real", "sync", "lockstep"),
                help="real: own clocks; sync: the plant follows SYNC; lockstep: no clock",
            )  # fmt: skip
            one.add_argument("--bus", metavar="INTERFACE[:CHANNEL]", help=_BUSES)
        _add_json(one, "print the summary as one JSON object")
        one.add_argument("--quiet", action="store_true", help="no progress")
        one.add_argument("--no-figure", action="store_true", help="do not draw figure.png")
        one.add_argument(
            "--judge", action="store_true",
            help="a limit that could not be judged, or nothing to judge, is exit code 1",
        )  # fmt: skip


def _add_table(commands: Any, texts: Mapping[str, str]) -> None:
    for name, example in _TABLE.items():
        one = _command(commands, name, texts, example)
        word, many = _NAMES.get(name, ("NAME", "+"))
        one.add_argument("names", nargs=many, metavar=word)
        one.add_argument(
            "--node", metavar="NODE",
            help="executive, plant, or a block's full name; without it, the one that has NAME",
        )  # fmt: skip
        _add_json(one, "print JSON")
        if name == "list":
            one.add_argument("-l", "--long", action="store_true", help="also writer and meaning")
        if name == "watch":
            one.add_argument(
                "--every", default="200ms", metavar="TIME", help="interval: 500us, 5ms, 10s"
            )


def _add_experiment(commands: Any, texts: Mapping[str, str]) -> None:
    one = _command(commands, "experiment", texts, "pcpc experiment chapter9 -o results")
    one.add_argument(
        "name", metavar="NAME", help="chapterN of the book, approximation, actuators, or a study.py"
    )
    one.add_argument(
        "-o", "--output", metavar="DIR", help="folder, instead of runs/<UTC time>-NAME"
    )
    one.add_argument("--jobs", type=int, metavar="N", help="processes; all processors")
    one.add_argument("--quiet", action="store_true", help="no progress")
