"""Commands: doctor."""

from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import WORD, Request
from pcpc.tools.terminal.rooms import Room


class DoctorRequest(Request):
    """What is looked at, and how it is printed."""

    rig: Annotated[str | None, WORD, "RIG", "with --bus: a rig whose frames are sent"] = None
    bus: Annotated[
        str | None, "CHANNEL[,CHANNEL]", "send frames: can0,can1 wired together, or one channel"
    ] = None
    frames: Annotated[
        int, take.positive, "N", "with --bus: of the longest pass; default: %(default)s"
    ] = 100_000
    tune: Annotated[bool, "measure, and print commands that improve real time"] = False
    json: take.Json = False


COMMANDS = (
    Command(
        "doctor",
        "show what this machine offers, and how to get the rest",
        "pcpc doctor\npcpc doctor --tune    # measures for 10 s\n"
        "pcpc doctor --bus can0,can1 hull    # is this adapter good enough?",
        DoctorRequest,
        codes=codes(
            OK="a rig can run; --bus: it is good",
            NOT_MET="--bus: it is not good, or was not judged",
            LOSS="--bus: frames were lost, doubled or changed",
            ENVIRONMENT="no rig can run; --bus: it cannot be used, or others talk",
            INTERRUPTED="",
        ),
        module="machine.doctor.cli",
        first=True,
    ),
)
ROOM = Room("docs/timing.md", "tests/tools/machine/test_doctor.py", "doctor")
