"""What `pcpc doctor` says about real time: kernel, permissions, CPUs, clocks, hypervisor.

The costs are measured figures of `drivers.machine.realtime`, or of the cause named.
"""

import json
import os
import platform
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

CPUS = Path("/sys/devices/system/cpu")
_CLOCKS = Path("/sys/devices/system/clocksource/clocksource0")
_IN_USER_SPACE = ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page")
_TRY = """
import json
from pcpc.drivers.machine import realtime
report = realtime.prepare_process() + realtime.prepare_thread(80, None)
print(json.dumps({s.name: [s.granted, s.detail] for s in report}))
"""
_GROUP = "sudo groupadd -f realtime && sudo usermod -aG realtime $USER"
_LIMITS = (
    r"printf '@realtime - rtprio 90\n@realtime - memlock unlimited\n' | "
    f"sudo tee /etc/security/limits.d/99-realtime.conf && {_GROUP}    # then log in again"
)
_CONTAINER = (
    "docker run --cap-add SYS_NICE --cap-add IPC_LOCK --ulimit rtprio=90 --ulimit memlock=-1"
)
_DMA_DEVICE = "docker run --device /dev/cpu_dma_latency    # in a container; else a kernel with it"
_DMA_RULE = (
    """echo 'KERNEL=="cpu_dma_latency", GROUP="realtime", MODE="0660"' | """
    f"sudo tee /etc/udev/rules.d/99-realtime.rules && {_GROUP} && sudo udevadm control --reload "
    "&& sudo udevadm trigger --name-match=cpu_dma_latency    # then log in again"
)


@dataclass(frozen=True)
class MachineFact:
    """One thing looked at; `cost` and `cure` where it is not ok."""

    name: str
    state: Literal["ok", "warn", "missing"]
    found: str
    cost: str = ""
    "without the cure; with --tune what the setting is worth; empty: none"
    cure: str = ""
    "a command; empty: none"


@dataclass(frozen=True)
class MachineFacts:
    """The exit code is 4 where no rig can run."""

    can_run: bool
    "nothing is missing"
    rows: list[MachineFact]


@dataclass(frozen=True)
class TuningFacts:
    """With --tune."""

    rows: list[MachineFact]


def machine_rows(project: Path) -> Iterator[MachineFact]:
    """Yield the rows about real time; `project` is the folder to import `drivers` from."""
    yield kernel_row(platform.version(), text(Path("/sys/kernel/realtime")) == "1")
    yield from permission_rows(project)
    yield _isolation_row()
    yield governor(CPUS)
    yield clock_row(*(text(_CLOCKS / f"{which}_clocksource") for which in ("current", "available")))
    yield hypervisor_row(_hypervisor(), text(Path("/proc/stat")))


def text(path: Path) -> str:
    """Return the stripped content of a small file, "" if it cannot be read."""
    try:
        return path.read_text().strip()
    except OSError:
        return ""


def kernel_row(version: str, realtime: bool) -> MachineFact:
    """Return the row for a kernel by the text of `uname -v` and its /sys/kernel/realtime."""
    words = version.split()
    if realtime or "PREEMPT_RT" in words:
        return MachineFact("kernel", "ok", f"{platform.release()}, PREEMPT_RT")
    model = next((word for word in words if word.startswith("PREEMPT")), "no PREEMPT in uname -v")
    distribution = text(Path("/etc/os-release"))
    cure = "# boot a kernel with PREEMPT_RT"
    if "ID=debian" in distribution.splitlines():
        architecture = {"x86_64": "amd64", "aarch64": "arm64"}.get(platform.machine(), "amd64")
        cure = f"sudo apt-get install -y linux-image-rt-{architecture} && sudo reboot"
    elif "ID=ubuntu" in distribution.splitlines():
        cure = "sudo pro enable realtime-kernel && sudo reboot"
    cost = "a kernel path can delay a wake-up by milliseconds"
    return MachineFact("kernel", "warn", f"{platform.release()}, {model}", cost, cure)


def permission_rows(project: Path) -> Iterator[MachineFact]:
    """Yield what a node's real-time settings came to in a child process."""
    done = subprocess.run(
        [sys.executable, "-c", _TRY], capture_output=True, text=True, cwd=project, timeout=60
    )
    if done.returncode:
        why = (done.stderr.splitlines() or [f"exit code {done.returncode}"])[-1]
        yield MachineFact("real-time set-up", "missing", why, "a node does the same and fails", "")
        return
    settings = json.loads(done.stdout)
    limits = _CONTAINER if os.geteuid() == 0 else _LIMITS
    dma = _DMA_RULE if os.path.exists("/dev/cpu_dma_latency") else _DMA_DEVICE
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    size = "unlimited" if limit == resource.RLIM_INFINITY else f"{limit >> 10} KiB"
    for name, more, cost, cure in (
        ("SCHED_FIFO", "", "p99 wake-up under load 37 times later", limits),
        ("mlockall", f"; limit {size}", "page faults in the loop", limits),
        ("cpu_dma_latency", "", "wake-up from idle 45 instead of 21 us", dma),
        ("timer slack", "", "wake-up 48 us later without SCHED_FIFO", ""),
    ):
        granted, detail = settings[name]
        if granted:
            yield MachineFact(name, "ok", detail + more)
        else:
            yield MachineFact(name, "warn", detail.partition(";")[0] + more, cost, cure)


def _isolation_row() -> MachineFact:
    isolated, count = text(CPUS / "isolated"), os.cpu_count() or 1
    if isolated:
        return MachineFact("isolated CPUs", "ok", f"{isolated} (use with `taskset -c {isolated}`)")
    if count < 4:
        return MachineFact("isolated CPUs", "ok", f"none, and none of {count} to spare")
    cpus = f"{count - 2},{count - 1}"
    cost = "other programs share the loops' CPUs"
    options = f"isolcpus={cpus} nohz_full={cpus} rcu_nocbs={cpus}"
    return MachineFact(
        "isolated CPUs", "warn", f"none of {count} CPUs", cost, boot_with(options, cpus)
    )


def boot_with(options: str, cpus: str) -> str:
    """Return the command that adds `options` to the kernel line and boots."""
    return (
        f"sudo sed -i 's/^GRUB_CMDLINE_LINUX=\"/&{options} /' /etc/default/grub && "
        f"sudo update-grub && sudo reboot    # then taskset -c {cpus} pcpc run RIG"
    )


def governor(folder: Path) -> MachineFact:
    """Return the row for the frequency governors of the processors in `folder`."""
    files = folder.glob("cpu[0-9]*/cpufreq/scaling_governor")
    governors = sorted({text(file) for file in files})
    if not governors:
        return MachineFact("CPU governor", "ok", "the kernel does not control the frequency")
    if governors == ["performance"]:
        return MachineFact("CPU governor", "ok", "performance")
    cure = f"echo performance | sudo tee {CPUS}/cpu*/cpufreq/scaling_governor"
    cost = "a loop that sleeps a lot runs at a low clock"
    return MachineFact("CPU governor", "warn", ", ".join(governors), cost, cure)


def clock_row(current: str, available: str) -> MachineFact:
    """Return the row for the kernel's clock source; `available` is the list to choose from."""
    if current in _IN_USER_SPACE:
        return MachineFact("clock source", "ok", current)
    better = next((name for name in _IN_USER_SPACE if name in available.split()), "")
    cure = f"echo {better} | sudo tee {_CLOCKS}/current_clocksource" if better else ""
    found = f"{current or 'unknown'}, of {available or 'unknown'}"
    return MachineFact(
        "clock source", "warn", found, "a system call for each look at the clock", cure
    )


def _hypervisor() -> str:
    """Return the kind of hypervisor, "" for none."""
    kind = ""
    if program := shutil.which("systemd-detect-virt"):
        done = subprocess.run([program, "--vm"], capture_output=True, text=True)
        kind = "" if done.stdout.strip() == "none" else done.stdout.strip()
    cpu_flags = text(Path("/proc/cpuinfo")).split()
    return kind or ("unknown kind" if "hypervisor" in cpu_flags else "")


def hypervisor_row(kind: str, stat: str) -> MachineFact:
    """Return the row for a kind of hypervisor and the text of /proc/stat."""
    if not kind:
        return MachineFact("hypervisor", "ok", "none")
    user, nice, system, *_, stolen = [int(word) for word in stat.split()[1:9]] or 4 * [0]
    if stolen:
        percent = 100.0 * stolen / (user + nice + system + stolen)
        kind += f"; its host took {percent:.2g} % of the time that programs wanted (steal)"
    cost = "its host can take a CPU away for milliseconds, whatever is set here"
    return MachineFact("hypervisor", "warn", kind, cost, "# run on a machine without a hypervisor")
