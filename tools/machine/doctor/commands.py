"""Commands: doctor."""

from typing import Annotated

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class DoctorRequest(Request):
    """What is looked at, and how it is printed."""

    tune: Annotated[bool, "measure, and print commands that improve real time"] = False
    json: take.Json = False


COMMANDS = (
    Command(
        "doctor",
        "show what this machine offers, and how to get the rest",
        "pcpc doctor\npcpc doctor --tune    # measures for 10 s",
        DoctorRequest,
        codes={Exit.OK: "a rig can run", Exit.ENVIRONMENT: "no rig can run"},
        module="machine.doctor.cli",
        first=True,
    ),
)
ROOM = Room("docs/timing.md", "tests/tools/machine/test_doctor.py", "doctor")
