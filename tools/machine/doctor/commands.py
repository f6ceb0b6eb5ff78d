"""Commands: doctor."""

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command


def doctor(add: Add) -> None:
    """Take only how to print."""
    take.json(add)


COMMANDS = (
    Command(
        "doctor",
        "what it offers, and how to get the rest",
        "pcpc doctor",
        doctor,
        codes={Exit.OK: "a rig can run", Exit.ENVIRONMENT: "it cannot"},
        module="machine.doctor.cli",
        first=True,
    ),
)
