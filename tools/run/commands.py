"""Commands: check, run, simulate, play."""

import argparse
from collections.abc import Sequence
from typing import Annotated, Any, Literal, NoReturn

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import HIDDEN, WORD, Offers, Request


class CheckRequest(take.RigRequest):
    """A rig, or none for the schema of all."""

    rig: Annotated[
        str, WORD, "RIG", "a rig's name (pcpc rigs), file or folder, or a run in progress"
    ] = ""
    json: take.Json = False
    schema: Annotated[
        bool, "print the JSON Schema of a rig file, for an editor; with RIG its own names, too"
    ] = False


class _RefusedOption(argparse.Action):
    """An option of the other commands that would have no effect here."""

    def __call__(self, parser: argparse.ArgumentParser, *given: Any) -> NoReturn:
        parser.error(f"{given[-1]}: not available in virtual time; use `pcpc run`")


class SimulateRequest(take.RigRequest):
    """A rig, without what has no effect in virtual time."""

    bus: Annotated[None, _RefusedOption, "--bus", "--pacing", HIDDEN] = None
    kept: take.RunFolder = take.RunFolder()
    digest: Annotated[bool, "print that of a page of `pcpc generate web`"] = False


class RunRequest(take.RigRequest):
    """A rig, how it runs on a bus, which of its nodes run here, and what rooms offer."""

    pacing: Annotated[
        Literal["real", "sync", "lockstep"] | None,
        "real: own clocks; sync: the plant follows SYNC; lockstep: no clock",
    ] = None
    bus: Annotated[str | None, "INTERFACE[:CHANNEL]", take.BUSES] = None
    kept: take.RunFolder = take.RunFolder()
    beside: Annotated[Offers, "BESIDE_RUN"] = Offers()
    only: Annotated[
        Literal["executive", "plant", "local"] | None,
        "start only this: executive and recorder, the emulator, or the third node",
    ] = None
    node: Annotated[str | None, "NAME", "--only plant: this one of a rig's plants, as plant_2"] = (
        None
    )
    in_place: Annotated[Offers, "BESIDE_PLANT"] = Offers()
    begin_ns: int = 0  # of the command, monotonic


class PlayRequest(Request):
    """A log, and which of its frames go where and when."""

    log: take.Log
    bus: Annotated[str, "INTERFACE[:CHANNEL]", take.BUSES] = "auto"
    rate: Annotated[
        float, "-r", "FACTOR", "speed: 2 is twice as fast; 0: as fast as the bus allows"
    ] = 1.0
    loop: Annotated[
        int | None, "N", "play N times; without N for ever", {"nargs": "?", "const": 0}
    ] = None
    start_s: Annotated[
        float, take.time, "--start", "TIME", "start 1.5 or 500ms after the log's first frame"
    ] = 0.0
    duration_s: Annotated[
        float | None, take.time, "--duration", "TIME", "play as long, as 2 or 500ms"
    ] = None
    step: Annotated[
        Literal["frame", "cycle"] | None,
        "send one frame, or one cycle, at each Enter",
        {"nargs": "?", "const": "frame"},
    ] = None
    only: Annotated[
        Sequence[str], "NAME|ID", "only this frame, by name or hexadecimal id; repeatable"
    ] = ()
    role: Annotated[
        Literal["executive", "plant"] | None,
        "--as",
        "send this node's frames once the other node is on the bus",
    ] = None
    no_wait: Annotated[bool, "--as: do not wait for the other node"] = False
    priority: Annotated[
        int, "-p", "1..99", "SCHED_FIFO priority, if allowed; default: %(default)s"
    ] = 70
    json: take.Json = False
    quiet: take.Quiet = False


COMMANDS = (
    Command(
        "check",
        "check a rig file and print its wiring and bus load",
        "pcpc check hull\npcpc check hull --schema    # for an editor",
        CheckRequest,
        codes=codes(ENVIRONMENT="the bus cannot be used"),
        judges=True,
        compiles=True,
        module="run.check",
        first=True,
    ),
    Command(
        "run",
        "start emulator, executive and recorder, and judge the run",
        "pcpc run hull\npcpc run hull --host --write\n"
        "pcpc run hull --only plant --bus vcan0    # beside: --only executive\n"
        "pcpc run probe --pacing lockstep --device ./firmware {bus}",
        RunRequest,
        judges=True,
        compiles=True,
        last="--device",
        module="run.run",
        first=True,
    ),
    Command(
        "simulate",
        "run a rig in virtual time, in one process, without a bus",
        "pcpc simulate hull --controller pid --set barrel.gap_rad=0.003",
        SimulateRequest,
        judges=True,
        compiles=True,
        module="run.simulate",
        first=True,
    ),
    Command(
        "play",
        "send recorded frames on a bus at their times",
        "pcpc play latest --bus vcan0\n"
        "pcpc play latest --start 2 --duration 1 --loop --only FB_A --only 0x080\n"
        "pcpc play latest --as plant --bus vcan0    # beside: pcpc run RIG --only executive",
        PlayRequest,
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
