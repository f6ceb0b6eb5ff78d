"""Commands: vm."""

from collections.abc import Sequence
from typing import Annotated, Literal

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room

_VM = """
The command runs as you, in this folder, with this environment, on the host's
files (read and write); /run and /dev/shm are the guest's own. Its stdin,
stdout and stderr are pipes, not a terminal. There is no network but loopback.
The first run fetches about 70 MB with apt, no root needed. Ctrl-C goes to the
command; twice, it ends the machine. Emulated time is not real time: use this
for function, not for timing. Its exit code is the command's; 124 time limit,
127 no such command.
"""


class VmRequest(Request):
    """What the machine has; the command follows after --."""

    accel: Annotated[Literal["auto", "kvm", "tcg"], "default: %(default)s"] = "auto"
    memory: Annotated[int, take.positive, "MB", "default: %(default)s"] = 2048
    cpus: Annotated[int, take.positive, "N", "default: %(default)s"] = 2
    timeout_s: Annotated[float, take.duration, "--timeout", "DURATION", "default: 600s"] = 600.0
    update: Annotated[bool, "fetch the distribution's present kernel"] = False
    verbose: Annotated[bool, "show the guest's console on stderr"] = False
    info: Annotated[bool, "print kernel and accelerator, run nothing"] = False
    rest: Sequence[str] = ()


COMMANDS = (
    Command(
        "vm",
        "run a command on a kernel with vcan, in QEMU",
        "pcpc vm -- sh -c 'candump -n 1 vcan0 & sleep 1; cansend vcan0 123#C0; wait'",
        VmRequest,
        notes=_VM,
        judges=True,
        rest="COMMAND [ARGUMENT ...]",
        module="machine.vm.cli",
        codes={Exit.WRONG_INPUT: "", Exit.ENVIRONMENT: "the machine did not start, or broke"},
    ),
)
ROOM = Room(
    "docs/howto/run.md", "tests/tools/machine/test_vm.py", "vm", needed_by=("machine/doctor",)
)
