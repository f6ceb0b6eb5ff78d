"""Commands: check, run, simulate, plant, exec, local, play."""

import argparse
from typing import Any, NoReturn

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes
from pcpc.tools.terminal.rooms import offers


def check(add: Add) -> None:
    """Take a rig."""
    take.rig(add)
    take.json(add)


def simulate(add: Add) -> None:
    """Take a rig, without what has no effect in virtual time."""
    take.rig(add)
    add("--bus", "--pacing", action=_RefusedOption, help=argparse.SUPPRESS)
    take.run_folder(add)
    add("--digest", action="store_true", help="print that of a page of `pcpc generate web`")


class _RefusedOption(argparse.Action):
    """An option of the other commands that would have no effect here."""

    def __call__(self, parser: argparse.ArgumentParser, *given: Any) -> NoReturn:
        parser.error(f"{given[-1]}: not available in virtual time; use `pcpc run`")


def plant(add: Add) -> None:
    """Take what `run` takes, and what other rooms offer."""
    take.run(add)
    add("--node", metavar="NAME", help="only this one of a rig's plants, as plant_2")
    for more in offers("BESIDE_PLANT"):
        more(add)


def play(add: Add) -> None:
    """Take a log, and which of its frames go where and when."""
    take.log(add)
    add("--bus", default="auto", metavar="INTERFACE[:CHANNEL]", help=take.BUSES)
    add(
        "-r",
        "--rate",
        type=float,
        default=1.0,
        metavar="FACTOR",
        help="speed: 2 is twice as fast; 0: as fast as the bus allows",
    )
    add(
        "--loop", type=int, nargs="?", const=0, metavar="N", help="play N times; without N for ever"
    )
    add(
        "--start",
        type=float,
        default=0.0,
        metavar="S",
        help="start S seconds after the log's first frame",
    )
    add("--duration", type=float, metavar="S", help="play S seconds")
    add(
        "--step",
        nargs="?",
        const="frame",
        choices=("frame", "cycle"),
        help="send one frame, or one cycle, at each Enter",
    )
    take.several(add, "--only", "NAME|ID", "only this frame, by name or hexadecimal id; repeatable")
    add(
        "--as",
        dest="role",
        choices=("executive", "plant"),
        help="send this node's frames once the other node is on the bus",
    )
    add("--no-wait", action="store_true", help="--as: do not wait for the other node")
    add(
        "-p",
        "--priority",
        type=int,
        default=70,
        metavar="1..99",
        help="SCHED_FIFO priority, if allowed; default: %(default)s",
    )
    take.json(add)
    take.quiet(add)


COMMANDS = (
    Command(
        "check",
        "check a rig file and print its wiring and bus load",
        "pcpc check hull",
        check,
        codes=codes(ENVIRONMENT="the bus cannot be used"),
        judges=True,
        compiles=True,
        module="run.check",
        first=True,
    ),
    Command(
        "run",
        "start emulator, executive and recorder, and judge the run",
        "pcpc run hull\npcpc run hull --host --write",
        take.run,
        judges=True,
        compiles=True,
        module="run.run",
        first=True,
    ),
    Command(
        "simulate",
        "run a rig in virtual time, in one process, without a bus",
        "pcpc simulate hull --controller pid --set barrel.gap_rad=0.003",
        simulate,
        judges=True,
        compiles=True,
        module="run.simulate",
        first=True,
    ),
    Command(
        "plant",
        "start the emulator only, or with your device as the executive",
        "pcpc plant hull --bus vcan0\npcpc plant probe --pacing lockstep --device ./firmware {bus}",
        plant,
        judges=True,
        compiles=True,
        last="--device",
        module="run.run",
    ),
    Command(
        "exec",
        "start executive and recorder only",
        "pcpc exec hull --bus vcan0",
        take.run,
        judges=True,
        compiles=True,
        module="run.run",
    ),
    Command(
        "local",
        "start only the third node of a rig with three",
        "pcpc local telerobot-u1 --bus vcan0",
        take.run,
        judges=True,
        compiles=True,
        module="run.run",
    ),
    Command(
        "play",
        "send recorded frames on a bus at their times",
        "pcpc play latest --bus vcan0\n"
        "pcpc play latest --start 2 --duration 1 --loop --only FB_A --only 0x080\n"
        "pcpc play latest --as plant --bus vcan0    # beside: pcpc exec RIG --bus vcan0",
        play,
        codes=codes(
            OK="played",
            LOSS="a frame was not sent, or the log is damaged",
            ENVIRONMENT="",
            INTERRUPTED="",
        ),
        judges=True,
        compiles=True,
        reads_logs=True,
        module="run.play",
    ),
)
