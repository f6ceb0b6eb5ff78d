"""`pcpc doctor --tune`: settings of this machine for real time, as commands, and their worth.

The worth of what a process may switch is measured, see `worth`. What takes a boot, or another
frequency, is not: `pcpc jitter --json` before and after shows it.
"""

import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from pcpc.tools.machine.doctor import rtla
from pcpc.tools.machine.doctor.machine import (
    CPUS,
    MachineFact,
    boot_with,
    governor,
    permission_rows,
    text,
)
from pcpc.tools.machine.doctor.worth import BLOCKS, ROUNDS, blocks, worth
from pcpc.tools.terminal.progress import Progress

_ISOLATING = ("isolcpus", "nohz_full", "rcu_nocbs")
_UNKNOWN = "not measured; `pcpc jitter --json` before and after shows it"
_IRQS = Path("/proc/irq")


def tune_rows(project: Path, progress: Progress) -> Iterator[MachineFact]:
    """Yield a row for each setting; `cost` is what it is worth."""
    found = []
    for block in blocks():
        found.append(block)
        progress.show(f"waking with and without, {len(found)} of {ROUNDS * len(BLOCKS)}")
    count = os.cpu_count() or 1
    line = text(Path("/proc/cmdline"))
    cpus = rig_cpus(line, count)
    yield kernel_line(line, cpus, count)
    yield interrupts(_IRQS, cpus, count)
    scaling = governor(CPUS)
    yield replace(scaling, cost=_UNKNOWN if scaling.cost else "")
    for row in permission_rows(project):
        if row.name in BLOCKS:
            yield replace(row, cost=worth(found, row.name))
    progress.show("rtla timerlat, 3 s")
    yield culprit()
    progress.close()


def cpu_set(written: str) -> set[int]:
    """Return the processors of `2-3,5`; flags such as `managed_irq` and other words are none."""
    found: set[int] = set()
    for part in written.split(","):
        first, _, last = part.partition("-")
        if first.isdecimal() and (last or first).isdecimal():
            found |= set(range(int(first), min(int(last or first), 8191) + 1))
    return found


def _cpu_list(cpus: set[int]) -> str:
    return ",".join(map(str, sorted(cpus)))


def _options(line: str) -> dict[str, set[int]]:
    pairs = (word.partition("=") for word in line.split())
    return {name: cpu_set(value) for name, _, value in pairs if name in _ISOLATING}


def rig_cpus(line: str, count: int) -> set[int]:
    """Return the processors for a rig: those that are isolated, else the last two of 4."""
    isolated = _options(line).get("isolcpus", set()) & set(range(count))
    return isolated or (set(range(count - 2, count)) if count >= 4 else set())


def kernel_line(line: str, cpus: set[int], count: int) -> MachineFact:
    """Return whether the kernel line `line` keeps everything else off `cpus`."""
    name = "kernel line"
    if not cpus:
        return MachineFact(
            name, "ok", f"none of {count} CPUs to spare: two loops and the rest need them"
        )
    given = _options(line)
    missing = [option for option in _ISOLATING if not cpus <= given.get(option, set())]
    if not missing:
        return MachineFact(name, "ok", f"{', '.join(_ISOLATING)}: CPUs {_cpu_list(cpus)}", _UNKNOWN)
    cure = boot_with(" ".join(f"{option}={_cpu_list(cpus)}" for option in missing), _cpu_list(cpus))
    return MachineFact(
        name, "warn", f"CPUs {_cpu_list(cpus)}: no {', '.join(missing)}", _UNKNOWN, cure
    )


def interrupts(folder: Path, cpus: set[int], count: int) -> MachineFact:
    """Return how many interrupts of `folder` may be handled on `cpus`."""
    name = "interrupts"
    if not cpus:
        return MachineFact(name, "ok", "no CPU is reserved for a rig")
    files = [text(file) for file in folder.glob("[0-9]*/smp_affinity_list")]
    there = sum(bool(cpu_set(file) & cpus) for file in files)
    found = f"{there} of {len(files)} may come to CPUs {_cpu_list(cpus)}"
    if not there:
        return MachineFact(name, "ok", found, _UNKNOWN)
    others = _cpu_list(set(range(count)) - cpus)
    balance = "sudo systemctl disable --now irqbalance; " if shutil.which("irqbalance") else ""
    cure = (
        f"{balance}for i in /proc/irq/[0-9]*; do echo {others} | "
        "sudo tee $i/smp_affinity_list; done    # until the next boot; some refuse"
    )
    return MachineFact(name, "warn", found, _UNKNOWN, cure)


def culprit() -> MachineFact:
    """Return who delays wake-ups most, where rtla is installed."""
    name = "latest wake-ups"
    if shutil.which("rtla") is None:
        cure = "sudo apt-get install -y rtla    # as root it names thread and interrupt"
        return MachineFact(name, "warn", "without rtla the cause has no name", "", cure)
    return MachineFact(name, "ok", rtla.run())
