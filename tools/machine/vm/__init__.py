"""`pcpc vm -- COMMAND`: runs a command where vcan0 exists, on any x86-64 Linux host with apt.

Boots the distribution's own kernel in QEMU with the host's root file system (virtio 9p), brings
vcan0 up, runs the command as the caller would, returns its output and exit code.

    cli          its course                         initramfs  init.sh, guest.sh, modules
    programs     what the host must have            machine    QEMU and its ports
    kernel       fetched by apt, kept in a cache    job        the command as a script
    unpack       what is compressed in it           session    streams, signals, limits, exit code
    accelerator  KVM only where proven              progress   what the user sees meanwhile
"""

from pcpc.tools.machine.vm.errors import VmError
from pcpc.tools.machine.vm.programs import APT_PACKAGES

__all__ = ["APT_PACKAGES", "VmError"]
