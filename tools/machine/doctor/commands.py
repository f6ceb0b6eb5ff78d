"""Commands: doctor."""

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command


def doctor(add: Add) -> None:
    """Take what to look at and how to print."""
    add("--tune", action="store_true", help="measure, and print commands that improve real time")
    take.json(add)


COMMANDS = (
    Command(
        "doctor",
        "show what this machine offers, and how to get the rest",
        "pcpc doctor\npcpc doctor --tune    # measures for 10 s",
        doctor,
        codes={Exit.OK: "a rig can run", Exit.ENVIRONMENT: "no rig can run"},
        module="machine.doctor.cli",
        first=True,
    ),
)
