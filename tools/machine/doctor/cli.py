"""`pcpc doctor`: what this machine offers for real time and CAN, and the command for the rest.

    ok        as it should be
    warn      a rig runs, at the stated cost
    missing   no rig runs without it

Changes nothing and needs no root. What a node does is tried as a node does it: real-time settings
in a child process, the bus with one datagram. The rest is read from /proc, /sys and /dev.
"""

import importlib.metadata
import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Literal

from pcpc.drivers.errors import Exit, UserError
from pcpc.tools.machine.doctor.commands import DoctorRequest
from pcpc.tools.machine.doctor.machine import MachineFact, MachineFacts, TuningFacts, machine_rows
from pcpc.tools.terminal import screen

_PROJECT = Path(__file__).resolve().parents[3]
_PYTHON = (3, 11)
_IMPORTS = {  # what every subcommand but `vm` needs: distribution, module
    "numpy": "numpy", "numba": "numba", "python-can": "can", "cantools": "cantools",
    "PyYAML": "yaml", "msgspec": "msgspec", "msgpack": "msgpack", "mcap": "mcap",
    "zstandard": "zstandard", "rich": "rich",
}  # fmt: skip
_NEEDS_BUS = "needs --bus CHANNEL[,CHANNEL]"
_COLOURS = {"ok": 32, "warn": 33, "missing": 31}  # of ANSI


def command(request: DoctorRequest) -> int:
    """Print a row for each thing looked at; ENVIRONMENT if no rig can run."""
    if request.bus is not None:
        request.refuse("goes without --bus", "tune")
        from pcpc.tools.machine.doctor.adapter.cli import command as examine  # the packages

        return examine(request)
    request.refuse(_NEEDS_BUS, "frames")
    if request.rig is not None:
        raise UserError(f"{request.rig}: {_NEEDS_BUS}")
    if request.tune:
        return tune(request.json)
    found = list(rows())
    missing = [row for row in found if row.state == "missing"]
    if request.json:
        print(json.dumps(asdict(MachineFacts(not missing, found)), indent=2))
    else:
        show(found)
    if missing:
        names = ", ".join(row.name for row in missing)
        print(f"no rig can run on this machine: missing {names}", file=sys.stderr)
    return Exit.ENVIRONMENT if missing else Exit.OK


def tune(as_json: bool) -> int:
    """Print settings of this machine, whether they are set and what they are worth."""
    from pcpc.tools.machine.doctor.tune import tune_rows  # here, because it needs the packages
    from pcpc.tools.terminal.progress import Progress

    found = list(tune_rows(_PROJECT, Progress(as_json)))
    if as_json:
        print(json.dumps(asdict(TuningFacts(found)), indent=2))
    else:
        show(found, "worth")
    return Exit.OK


def rows() -> Iterator[MachineFact]:
    """Yield all rows in the order of printing."""
    yield python_row()
    packages = packages_row()
    yield packages
    yield figures_row()
    yield from addition_rows()
    yield from machine_rows(_PROJECT)
    if packages.state == "ok":
        from pcpc.tools.machine.doctor.bus import bus_rows  # here, because it needs the packages

        yield from bus_rows()
    else:
        yield MachineFact("buses", "warn", "not looked at", "see packages")
    yield node_memory_row()
    yield compile_cache_row()
    yield c_compiler_row()


def show(found: list[MachineFact], price: str = "costs") -> None:
    """Print what was found and what it costs, and below it the commands to copy."""
    broad = max(len(row.name) for row in found)
    for row in found:
        ahead = f"{row.state:7}  {row.name:{broad}}  "
        lines = screen.wrapped_lines(row.found, ahead)
        if row.cost:
            lines += screen.wrapped_lines(f"{price}: {row.cost}", " " * len(ahead))
        if sys.stdout.isatty():
            lines[0] = f"\x1b[{_COLOURS[row.state]}m{row.state}\x1b[0m{lines[0][len(row.state) :]}"
        print("\n".join(lines))
    cures = [row for row in found if row.cure]
    print("\nto mend:" if cures else "\nnothing to mend")
    for row in cures:
        command, _, remark = row.cure.partition("    # ")
        print(f"  # {row.name}{f', {remark}' if remark else ''}")
        print("\n".join(screen.shell(command)))


def python_row() -> MachineFact:
    """Return whether this Python is new enough."""
    found = f"{platform.python_version()}, {platform.machine()}, {sys.executable}"
    if sys.version_info[:2] >= _PYTHON:
        return MachineFact("python", "ok", found)
    wanted = ".".join(map(str, _PYTHON))
    return MachineFact(
        "python", "missing", found, f"needs {wanted}", f"python{wanted} -m venv .venv"
    )


def packages_row() -> MachineFact:
    """Import every package in a child: one that is broken must not break the doctor."""
    lines = [
        f"try:\n import {m}\nexcept Exception as e:\n print({d!r}, e, sep=': ')"
        for d, m in _IMPORTS.items()
    ]
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, cwd=_PROJECT
    )
    broken = done.stdout.splitlines()
    if done.returncode:
        broken.append(f"the import ended with code {done.returncode}")
    if broken:
        cure = f"{sys.executable} -m pip install -e {_PROJECT}"
        return MachineFact(
            "packages", "missing", "; ".join(broken), "nothing runs without them", cure
        )
    versions = (f"{name} {importlib.metadata.version(name)}" for name in _IMPORTS)
    return MachineFact("packages", "ok", ", ".join(versions))


def addition_rows() -> Iterator[MachineFact]:
    """Yield what packages of others add; loaded in a child, which may be ended by one of them."""
    from pcpc.tools.terminal import additions  # here, because it needs the packages

    if not (names := [*additions.lines()]):
        return
    command = [sys.executable, "-P", "-m", additions.__name__]
    said: list[str] = []
    while len(said) < len(names):
        done = subprocess.run([*command, str(len(said))], capture_output=True, text=True)
        said += done.stdout.splitlines()
        said += ["its import ended the process"] if len(said) < len(names) else []
    for why, (name, whose) in zip(said, names, strict=False):
        state: Literal["ok", "warn"] = "warn" if why else "ok"
        yield MachineFact(name, state, why or whose, "it cannot be used" if why else "")


def figures_row() -> MachineFact:
    """Return whether runs can draw their figure."""
    try:
        return MachineFact("matplotlib", "ok", importlib.metadata.version("matplotlib"))
    except importlib.metadata.PackageNotFoundError:
        cure = f"{sys.executable} -m pip install -e '{_PROJECT}[plot]'"
        return MachineFact("matplotlib", "warn", "not installed", "no figure.png of a run", cure)


def node_memory_row() -> MachineFact:
    """Return whether a node can have its memory, and hand it to clients."""
    try:
        from pcpc.executive.loop.shared import LOOP, SharedError  # time
        from pcpc.executive.loop.sharing import ServedMemory
    except ImportError:
        return MachineFact("node memory", "missing", "not tried", "see packages")
    try:
        served = ServedMemory(
            "doctor", {"variables": [], "state_columns": [], "timing_columns": []}
        )
        served.open()
    except SharedError as error:
        return MachineFact("node memory", "missing", str(error), "no node can start", "")
    sealed = served.is_sealed()
    served.close()
    found = f"{LOOP.itemsize >> 20} MiB, sealed memory files and abstract sockets"
    if sealed:
        return MachineFact("node memory", "ok", found)
    cost = "this user's programs could write what a node publishes"
    return MachineFact("node memory", "warn", found, cost, "# run a kernel from 5.1 on")


def compile_cache_row() -> MachineFact:
    """Return whether the next start finds compiled code."""
    from pcpc.drivers.compiled import compile_cache  # time

    try:
        folder = compile_cache.cache_folder()
    except importlib.metadata.PackageNotFoundError:
        return MachineFact("compile cache", "warn", "no numba", "see packages")
    why, warm = compile_cache.distrust(folder), compile_cache.used_folder()
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if not (why or os.access(existing, os.W_OK | os.X_OK)):
        why = f"{existing} is not writable"
    if why:
        cure = "export XDG_CACHE_HOME=/var/tmp/cache-$USER"
        cost = f"compiled code goes to {compile_cache.temporary_folder()}, if at all"
        return MachineFact(
            "compile cache", "warn", why + (f"; warm, {warm}" if warm else ""), cost, cure
        )
    if warm:
        return MachineFact("compile cache", "ok", f"warm, {warm}")
    cure = "pcpc simulate slew10 --no-figure -o $(mktemp -d)"
    cost = "the first start compiles for about 20 s"
    return MachineFact("compile cache", "warn", f"cold, {folder}", cost, cure)


def c_compiler_row() -> MachineFact:
    """Return the compiler that only the bench of the repository uses."""
    for name in ("cc", "gcc", "clang"):
        if path := shutil.which(name):
            return MachineFact("C compiler", "ok", path)
    cost = "no comparison with C in `pcpc jitter`; nothing else needs it"
    return MachineFact("C compiler", "warn", "none", cost, "sudo apt-get install -y gcc libc6-dev")
