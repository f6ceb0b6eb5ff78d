"""QEMU with five virtio serial ports and a console, each a socket pair: no file, no clash.

QEMU is ended when this process is (setpriv --pdeathsig), however that happens.
"""

import contextlib
import socket
import subprocess
from dataclasses import dataclass

from pcpc.tools.machine.vm.kernel import Kernel
from pcpc.tools.machine.vm.programs import Programs

PORTS = ("control", "job", "in", "out", "err")

# console: only problems; a panic resets, and a reset ends QEMU (-no-reboot). no_timer_check: else
# the kernel panics where a busy host lets its ticks come late (IO-APIC + timer doesn't work)
_KERNEL_ARGUMENTS = (
    "console=ttyS0 quiet loglevel=4 panic=-1 oops=panic mitigations=off nokaslr no_timer_check "
    "random.trust_cpu=on rcupdate.rcu_expedited=1 cryptomgr.notests"
)


@dataclass(frozen=True)
class Size:
    """What the guest gets."""

    cpus: int
    memory_mb: int


class Machine:
    """A running QEMU, until the end of its `with`; `sockets` by name: the ports and `console`."""

    def __init__(self, programs: Programs, kernel: Kernel, size: Size, accelerator: str) -> None:
        """Start QEMU. `accelerator` is kvm or tcg."""
        self.sockets: dict[str, socket.socket] = {}
        theirs: dict[str, socket.socket] = {}
        for name in (*PORTS, "console"):
            self.sockets[name], theirs[name] = socket.socketpair()
        numbers = {name: end.fileno() for name, end in theirs.items()}
        command = [programs.setpriv, "--pdeathsig", "KILL", "--"]
        command += qemu_command(programs.qemu, kernel, size, accelerator, numbers)
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=numbers["console"],
            stderr=numbers["console"],
            pass_fds=list(numbers.values()),
            start_new_session=True,  # Ctrl-C reaches us alone
        )
        for end in theirs.values():
            end.close()

    def __enter__(self) -> "Machine":
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        for end in self.sockets.values():
            end.close()

    def send(self, port: str, data: bytes) -> None:
        """Send to a port; a machine that is gone is noticed elsewhere."""
        with contextlib.suppress(OSError):
            self.sockets[port].sendall(data)

    def close(self, port: str) -> None:
        """Let the guest read end of file after what was sent (a full close loses the unread)."""
        with contextlib.suppress(OSError):
            self.sockets[port].shutdown(socket.SHUT_WR)


def qemu_command(
    qemu: str, kernel: Kernel, size: Size, accelerator: str, numbers: dict[str, int]
) -> list[str]:
    """Return QEMU's command line; `numbers` are the descriptors of the ports and the console."""
    accel = {"kvm": "kvm", "tcg": "tcg,thread=multi"}[accelerator]
    fixed = (
        "-nodefaults -no-user-config -no-reboot -display none "
        f"-machine pc,graphics=off,vmport=off -accel {accel} -cpu max "
        f"-smp {size.cpus} -m {size.memory_mb} -rtc base=utc "
        "-fsdev local,id=host,path=/,security_model=none,multidevs=remap "
        "-device virtio-9p-pci,fsdev=host,mount_tag=host "
        f"-chardev socket,id=console,fd={numbers['console']} "
        "-serial chardev:console -device virtio-serial-pci"
    )
    ports = (
        f"-chardev socket,id={port},fd={numbers[port]} "
        f"-device virtserialport,chardev={port},name=pcpc.{port}"
        for port in PORTS
    )
    files = ["-kernel", str(kernel.image), "-initrd", str(kernel.initramfs)]
    words = " ".join([fixed, *ports]).split()
    return [qemu, *words, *files, "-append", _KERNEL_ARGUMENTS]
