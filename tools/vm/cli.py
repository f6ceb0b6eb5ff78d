"""Arguments and course of `pcpc vm`."""

import argparse
import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from pcpc.tools import screen
from pcpc.tools.vm import accelerator, kernel, programs
from pcpc.tools.vm.errors import VmError
from pcpc.tools.vm.job import job_of_caller, script
from pcpc.tools.vm.machine import Machine, Size
from pcpc.tools.vm.progress import Progress
from pcpc.tools.vm.session import Limits, Session

_UNIT_S = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
_GUESTS_OWN = ("/run", "/dev", "/proc", "/sys")
_EPILOG = """example:
  pcpc vm -- sh -c 'candump -n 1 vcan0 & sleep 1; cansend vcan0 123#C0; wait'

The command runs as you, in this folder, with this environment, on the host's
files (read and write); /run and /dev/shm are the guest's own. Its stdin,
stdout and stderr are pipes, not a terminal. There is no network but loopback.
The first run fetches about 70 MB with apt, no root needed. Ctrl-C goes to the
command; twice, it ends the machine. Emulated time is not real time: use this
for function, not for timing.

exit code: the command's; 124 time limit, 127 no such command, 2 wrong usage,
  4 the machine cannot be provided or broke"""


def run(argv: list[str]) -> int:
    """Run `pcpc vm` with the arguments after `vm`; return the exit code."""
    options = _options(argv)
    try:
        return _print_info(options) if options.info else _run_command(options)
    except (VmError, OSError, subprocess.CalledProcessError) as error:
        raise VmError(f"vm: {error}") from None


@dataclass(frozen=True)
class Options:
    """The parsed command line."""

    command: list[str]
    accel: str
    size: Size
    timeout_s: float
    verbose: bool
    info: bool
    update: bool


def seconds(text: str) -> float:
    """Return a duration such as 500ms, 10s, 2min in s. Raises argparse.ArgumentTypeError."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)(ms|s|min|h)", text)
    if match is None or float(match[1]) == 0.0:
        raise argparse.ArgumentTypeError(f"expected a duration like 90s or 10min, got {text!r}")
    return float(match[1]) * _UNIT_S[match[2]]


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"expected a positive whole number, got {text!r}")
    return int(text)


def _options(argv: list[str]) -> Options:
    parser = argparse.ArgumentParser(
        prog="pcpc vm",
        usage="pcpc vm [options] -- COMMAND [ARGUMENT ...]",
        description="Run a command in a virtual machine that has vcan0, on the host's files.",
        epilog=_EPILOG,
        formatter_class=screen.Help,
    )
    add = parser.add_argument
    add("--accel", choices=("auto", "kvm", "tcg"), default="auto", help="default: %(default)s")
    add("--memory", type=_positive, default=2048, metavar="MB", help="default: %(default)s")
    add("--cpus", type=_positive, default=2, metavar="N", help="default: %(default)s")
    add("--timeout", type=seconds, default=600.0, metavar="DURATION", help="default: 600s")
    add("--update", action="store_true", help="fetch the distribution's present kernel")
    add("--verbose", action="store_true", help="show the guest's console on stderr")
    add("--info", action="store_true", help="print kernel and accelerator, run nothing")
    split = argv.index("--") if "--" in argv else len(argv)
    known = parser.parse_args(argv[:split])
    command = argv[split + 1 :]
    if not command and not known.info:
        parser.error("no command; put it after --, as in: pcpc vm -- ip link")
    return Options(
        command=command,
        accel=known.accel,
        size=Size(cpus=known.cpus, memory_mb=known.memory),
        timeout_s=known.timeout,
        verbose=known.verbose,
        info=known.info,
        update=known.update,
    )


def _run_command(options: Options) -> int:
    folder = Path.cwd()
    if any(folder.is_relative_to(own) for own in _GUESTS_OWN):
        raise VmError(
            f"{folder} is not shared: the guest has its own {'/'.join(folder.parts[:2])[1:]}"
        )
    tools = programs.found_programs()
    if shutil.which(options.command[0], path=os.environ.get("PATH", os.defpath)) is None:
        print(f"vm: {options.command[0]}: no such command", file=sys.stderr)
        return 127
    progress = Progress(options.verbose)
    cache = kernel.cache_folder()
    ready = kernel.prepared(tools, cache, options.update, progress.say)
    job = script(job_of_caller(options.command), tools.setpriv)

    first = accelerator.chosen(options.accel, cache)
    proving = first == "kvm" and options.accel == "auto"
    limits = Limits(options.timeout_s, accelerator.KVM_BOOT_LIMIT_S if first == "kvm" else math.inf)
    progress.boots(f"linux {ready.release} ({first})")
    with Machine(tools, ready, options.size, first) as machine:
        session = Session(machine, job, limits, progress)
        try:
            return session.run()
        except VmError:
            if not proving or session.up:
                raise
        finally:
            if proving and session.up:
                accelerator.remember(cache, "kvm")
    accelerator.remember(cache, "tcg")
    progress.say("KVM does not work here")
    progress.boots(f"linux {ready.release} (tcg)")
    with Machine(tools, ready, options.size, "tcg") as machine:
        return Session(machine, job, Limits(options.timeout_s), progress).run()


def _print_info(options: Options) -> int:
    cache = kernel.cache_folder()
    tools = programs.found_programs()
    release = kernel.cached_release(cache)
    if release is None or options.update:
        release, packages = kernel.packages_to_fetch(tools)
        print(f"kernel       linux {release}, to be fetched: {' '.join(packages)}")
    else:
        package = (cache / release / "package").read_text().strip()
        print(f"kernel       linux {release}, in the cache: {package}")
    print(f"accelerator  {accelerator.explained(options.accel, cache)}")
    print(f"cache        {cache}")
    return 0
