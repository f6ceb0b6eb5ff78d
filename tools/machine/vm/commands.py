"""Commands: vm."""

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command

_VM = """
The command runs as you, in this folder, with this environment, on the host's
files (read and write); /run and /dev/shm are the guest's own. Its stdin,
stdout and stderr are pipes, not a terminal. There is no network but loopback.
The first run fetches about 70 MB with apt, no root needed. Ctrl-C goes to the
command; twice, it ends the machine. Emulated time is not real time: use this
for function, not for timing. Its exit code is the command's; 124 time limit,
127 no such command.
"""


def vm(add: Add) -> None:
    """Take what the machine has; the command follows after --."""
    add("--accel", choices=("auto", "kvm", "tcg"), default="auto", help="default: %(default)s")
    add("--memory", type=take.positive, default=2048, metavar="MB", help="default: %(default)s")
    add("--cpus", type=take.positive, default=2, metavar="N", help="default: %(default)s")
    add("--timeout", type=take.duration, default=600.0, metavar="DURATION", help="default: 600s")
    add("--update", action="store_true", help="fetch the distribution's present kernel")
    add("--verbose", action="store_true", help="show the guest's console on stderr")
    add("--info", action="store_true", help="print kernel and accelerator, run nothing")


COMMANDS = (
    Command(
        "vm",
        "run a command on a kernel with vcan, in QEMU",
        "pcpc vm -- sh -c 'candump -n 1 vcan0 & sleep 1; cansend vcan0 123#C0; wait'",
        vm,
        notes=_VM,
        judges=True,
        rest="COMMAND [ARGUMENT ...]",
        module="machine.vm.cli",
        codes={Exit.WRONG_INPUT: "", Exit.ENVIRONMENT: "the machine did not start, or broke"},
    ),
)
