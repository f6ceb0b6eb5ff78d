"""What `pcpc doctor` says about buses: SocketCAN, vcan, UDP multicast, and the virtual machine.

The datagram goes through the very sockets that a node opens on the default bus.
"""

import errno
import os
import platform
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

from pcpc.drivers.can import bus
from pcpc.drivers.errors import BusError
from pcpc.tools.machine.doctor.machine import MachineFact, text
from pcpc.tools.machine.vm import APT_PACKAGES, VmError, accelerator, kernel, programs

_NET = Path("/sys/class/net")
_ARPHRD_CAN = "280"
_IFF_UP = 1
_PROBE = b"pcpc doctor"
_MAKE_VCAN = "sudo ip link add dev vcan0 type vcan && sudo ip link set vcan0 up"


def bus_rows() -> Iterator[MachineFact]:
    """Yield the rows about buses; one bus that works is enough for a rig to run."""
    refusal = _can_refusal()
    interfaces = can_interfaces() if not refusal else {}
    heard = multicast_heard()
    yield _af_can(refusal)
    yield _interfaces(interfaces, refusal)
    usable = any(interfaces.values())
    if heard == "":
        yield MachineFact(
            "udp_multicast", "ok", f"a datagram came back on {bus.UDP_GROUP}, loopback"
        )
    else:
        cost = "no bus without CAN" + (
            "" if usable else ", and there is no CAN interface up either"
        )
        cure = "sudo ip link set lo up multicast on"
        yield MachineFact("udp_multicast", "warn" if usable else "missing", heard, cost, cure)
    yield _vm()
    yield _kvm()


def _can_refusal() -> str:
    """Return why there are no CAN sockets, "" if there are."""
    if not hasattr(socket, "AF_CAN"):
        return "this Python was built without AF_CAN"
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return f"{errno.errorcode.get(error.errno or 0, '')} {error.strerror}".strip()
    return ""


def can_interfaces() -> dict[str, bool]:
    """Return the CAN interfaces of this machine, each with True if it is up."""
    found = {}
    for folder in sorted(_NET.iterdir()) if _NET.is_dir() else ():
        if text(folder / "type") == _ARPHRD_CAN:
            found[folder.name] = int(text(folder / "flags") or "0", 16) & _IFF_UP == 1
    return found


def multicast_heard() -> str:
    """Send a datagram through a node's sockets on a free port; return "" or what went wrong."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind((bus.LOOPBACK, 0))
        port = free.getsockname()[1]
    try:
        ends = bus._open_udp(f"{bus.UDP_GROUP}:{port}")
    except BusError as error:
        return str(error)
    sender, receiver = (socket.socket(fileno=descriptor) for descriptor in ends)
    with sender, receiver:
        try:
            sender.send(_PROBE)
            received = os.read(receiver.fileno(), len(_PROBE))  # SO_RCVTIMEO bounds it
        except BlockingIOError:
            return f"a datagram to {bus.UDP_GROUP} on loopback did not come back"
        except OSError as error:
            return f"{bus.UDP_GROUP} on loopback: {error.strerror}"
    return "" if received == _PROBE else f"another datagram came back: {received!r}"


def _has_module(name: str) -> bool:
    program = shutil.which("modinfo", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
    return (
        program is not None and not subprocess.run([program, name], capture_output=True).returncode
    )


def _kernel_with_can() -> str:
    release = platform.release()
    if "-cloud-" in release:
        return "sudo apt-get install -y linux-image-amd64 && sudo reboot"
    if release.endswith("-generic"):
        return f"sudo apt-get install -y linux-modules-extra-{release}"
    return "pcpc vm -- pcpc run RIG --bus vcan0"


def _af_can(refusal: str) -> MachineFact:
    if not refusal:
        return MachineFact("AF_CAN", "ok", "raw CAN sockets")
    cure = "sudo modprobe -a can_raw vcan" if _has_module("can_raw") else _kernel_with_can()
    return MachineFact("AF_CAN", "warn", refusal, "no SocketCAN; rigs run on udp_multicast", cure)


def _interfaces(interfaces: dict[str, bool], refusal: str) -> MachineFact:
    name = "CAN interfaces"
    found = ", ".join(f"{i} {'up' if up else 'down'}" for i, up in interfaces.items()) or "none"
    if any(interfaces.values()):
        return MachineFact(name, "ok", found)
    cost = "no candump beside a run; rigs run on udp_multicast"
    if interfaces:
        first = next(iter(interfaces))
        bitrate = "" if first.startswith("vcan") else " type can bitrate 1000000"
        return MachineFact(name, "warn", found, cost, f"sudo ip link set {first} up{bitrate}")
    if not refusal or _has_module("vcan"):
        return MachineFact(name, "warn", found, cost, f"sudo modprobe vcan && {_MAKE_VCAN}")
    return MachineFact(name, "warn", found, cost, "pcpc vm -- pcpc run RIG --bus vcan0")


def _vm() -> MachineFact:
    try:
        tools = programs.found_programs()
    except VmError as error:
        cure = f"sudo apt-get install -y {' '.join(APT_PACKAGES)}"
        cost = "no `pcpc vm`: no vcan where the kernel has none"
        if platform.machine() != "x86_64" or not shutil.which("apt-get"):
            cure = ""
        return MachineFact("pcpc vm", "warn", str(error).partition(";")[0], cost, cure)
    return MachineFact("pcpc vm", "ok", tools.qemu)


def _kvm() -> MachineFact:
    cost = "`pcpc vm` takes 12 to 16 s to a shell, emulated, instead of 2 s"
    if not os.path.exists("/dev/kvm"):
        cure = "sudo modprobe kvm_intel || sudo modprobe kvm_amd    # on in firmware"
        return MachineFact("KVM", "warn", "no /dev/kvm", cost, cure)
    if not accelerator.kvm_is_open():
        cure = "sudo usermod -aG kvm $USER    # then log in again"
        return MachineFact("KVM", "warn", "/dev/kvm is not writable", cost, cure)
    proven = accelerator.proven_accelerator(kernel.cache_folder())
    if proven == "tcg":
        cure = f"rm {kernel.cache_folder() / 'accelerator'}    # to try it once more"
        return MachineFact("KVM", "warn", "/dev/kvm, but a guest did not boot with it", cost, cure)
    return MachineFact(
        "KVM", "ok", "/dev/kvm" + (", a guest has booted" if proven else ", untried")
    )
