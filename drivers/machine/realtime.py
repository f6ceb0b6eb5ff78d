"""Real-time set-up of a process and its loop thread: each setting is tried, reported, not required.

    setting          what it buys                                    who may
    gc               no collection pauses                            everyone
    cpu_dma_latency  wake-up from idle 45 -> 21 us                   writers of /dev/cpu_dma_latency
    mlockall         no page faults in the loop; paced runs only     CAP_IPC_LOCK, memlock unlimited
    timer slack      48 us earlier wake-up of an ordinary thread     everyone
    SCHED_FIFO       37 times better p99 under load                  CAP_SYS_NICE, rtprio limit
    affinity         little; set on request, and never without FIFO  everyone

mlockall is not tried under a finite memlock limit: once future pages are locked too, the allocation
that passes the limit fails. Nor in lockstep, where nothing waits for a clock: it takes some 0.03 s.
Slack comes before SCHED_FIFO, under which newer kernels fix it at 0. Scheduling, slack and affinity
belong to the calling thread alone. Gains: measured on one machine.
"""

import ctypes
import errno as codes
import gc
import os
import resource
from collections.abc import Iterator
from dataclasses import dataclass

from pcpc.drivers.machine import locked_memory

_CAP_IPC_LOCK = 14
_CPU_DMA_LATENCY = "/dev/cpu_dma_latency"
_INITIAL_USER_NAMESPACE = (
    0xEFFFFFFD  # inode; elsewhere CAP_IPC_LOCK does not lift the memlock limit
)
_LATENCY_0_US = bytes(4)
_PR_SET_TIMERSLACK = 29
_SLACK_NS = 1  # 0 would mean the default of 50 us

_GROUP = "to /etc/security/limits.conf and yourself to the group realtime"
_CURE_FIFO = f"run as root, or add `@realtime - rtprio 90` {_GROUP}"
_CURE_MEMLOCK = f"run as root, or add `@realtime - memlock unlimited` {_GROUP}"
_CURE_LATENCY = (
    'run as root, or add `KERNEL=="cpu_dma_latency", GROUP="realtime", MODE="0660"` to '
    "/etc/udev/rules.d/99-realtime.rules and yourself to the group realtime"
)

_libc = ctypes.CDLL(None, use_errno=True)
_libc.prctl.argtypes = [ctypes.c_int, *4 * [ctypes.c_ulong]]


@dataclass(frozen=True)
class Setting:
    """One setting: granted or refused, with its value, or the reason and the cure, in `detail`."""

    name: str
    granted: bool
    detail: str


@dataclass(frozen=True)
class Report:
    """What became of each setting; reports of a process and its thread add up with `+`."""

    settings: tuple[Setting, ...]

    def __add__(self, other: "Report") -> "Report":
        return Report(self.settings + other.settings)

    def __iter__(self) -> Iterator[Setting]:
        return iter(self.settings)

    @property
    def is_realtime(self) -> bool:
        """True if the loop thread runs under SCHED_FIFO: the mark of a run in its log."""
        return any(s.granted for s in self.settings if s.name == "SCHED_FIFO")

    def refused(self) -> tuple[Setting, ...]:
        """Return the refused settings, SCHED_FIFO first."""
        refused = [s for s in self.settings if not s.granted]
        return tuple(sorted(refused, key=lambda s: s.name != "SCHED_FIFO"))

    def warning(self) -> str:
        """Return one line: the first refusal with its cure, the names of the others; "" if none."""
        first, *others = self.refused() or (None,)
        if first is None:
            return ""
        text = "real time with reservations" if self.is_realtime else "not hard real time"
        text += f": {first.name} refused ({first.detail})"
        if others:
            text += "; also refused: " + ", ".join(s.name for s in others)
        return text


def prepare_process(paced: bool = True) -> Report:
    """Set up this process, once, after imports and before the loop thread starts.

    `paced`: its loop waits for a clock, and its memory is locked.
    """
    memory = (_lock_memory(),) if paced else ()
    return Report((_freeze_garbage_collector(), _hold_cpu_awake(), *memory))


def prepare_thread(priority: int, cpu: int | None) -> Report:
    """Set up the calling thread: SCHED_FIFO `priority` 1 to 99, and its one `cpu` if not None."""
    slack = _shorten_timer_slack()
    fifo = _schedule_fifo(priority)
    if cpu is None:
        return Report((slack, fifo))
    if not fifo.granted:
        return Report((slack, fifo, Setting("affinity", False, "only useful with SCHED_FIFO")))
    return Report((slack, fifo, _stay_on(cpu)))


def _freeze_garbage_collector() -> Setting:
    gc.collect()
    gc.freeze()
    gc.disable()
    return Setting("gc", True, "collected, frozen and disabled")


def _hold_cpu_awake() -> Setting:
    """Ask for no C-states; it holds while the file is open: until this process ends."""
    name = "cpu_dma_latency"
    try:
        descriptor = os.open(_CPU_DMA_LATENCY, os.O_WRONLY)
        os.write(descriptor, _LATENCY_0_US)
    except PermissionError as error:
        return Setting(name, False, f"{error.strerror}; {_CURE_LATENCY}")
    except OSError as error:
        return Setting(name, False, f"{_CPU_DMA_LATENCY}: {error.strerror}")
    return Setting(name, True, "0 us")


def _lock_memory() -> Setting:
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit != resource.RLIM_INFINITY and not _may_lock_memory():
        return Setting("mlockall", False, f"memlock limit is {limit // 1024} KiB; {_CURE_MEMLOCK}")
    try:
        locked_memory.lock()
    except OSError as error:
        return Setting("mlockall", False, error.strerror or str(error))
    return Setting("mlockall", True, "current and future pages")


def _may_lock_memory() -> bool:
    """Return True if CAP_IPC_LOCK lifts the memlock limit for this process."""
    try:
        if os.stat("/proc/self/ns/user").st_ino != _INITIAL_USER_NAMESPACE:
            return False
        with open("/proc/thread-self/status") as status:
            effective = next(line for line in status if line.startswith("CapEff:"))
    except OSError:
        return False
    return bool(int(effective.split()[1], 16) >> _CAP_IPC_LOCK & 1)


def _shorten_timer_slack() -> Setting:
    if _libc.prctl(_PR_SET_TIMERSLACK, _SLACK_NS, 0, 0, 0) != 0:
        return Setting("timer slack", False, os.strerror(ctypes.get_errno()))
    return Setting("timer slack", True, f"{_SLACK_NS} ns")


def _schedule_fifo(priority: int) -> Setting:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError as error:
        return Setting("SCHED_FIFO", False, f"{error.strerror}; {_CURE_FIFO}")
    except OSError as error:
        hint = "; expected a priority of 1 to 99" if error.errno == codes.EINVAL else ""
        return Setting("SCHED_FIFO", False, f"priority {priority}: {error.strerror}{hint}")
    return Setting("SCHED_FIFO", True, f"priority {priority}")


def _stay_on(cpu: int) -> Setting:
    allowed = sorted(os.sched_getaffinity(0))
    try:
        os.sched_setaffinity(0, {cpu})
    except (OSError, ValueError) as error:
        return Setting("affinity", False, f"cpu {cpu}: {error}; this process may use {allowed}")
    return Setting("affinity", True, f"cpu {cpu}")
