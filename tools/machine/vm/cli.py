"""Course of `pcpc vm`."""

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.tools.machine.vm import accelerator, kernel, programs
from pcpc.tools.machine.vm.commands import VmRequest
from pcpc.tools.machine.vm.errors import VmError
from pcpc.tools.machine.vm.job import job_of_caller, script
from pcpc.tools.machine.vm.machine import Machine, Size
from pcpc.tools.machine.vm.progress import Progress
from pcpc.tools.machine.vm.session import MachineSession, TimeLimits

_GUESTS_OWN = ("/run", "/dev", "/proc", "/sys")


def command(request: VmRequest) -> int:
    """Run the words behind --, `request.rest`, in a machine; return their exit code.

    VmError: wrong input, or no machine.
    """
    if not request.rest and not request.info:
        raise VmError("no command; put it after --, as in: pcpc vm -- ip link", Exit.WRONG_INPUT)
    try:
        return _print_info(request) if request.info else _run_command(request)
    except (VmError, OSError, subprocess.CalledProcessError) as error:
        raise VmError(f"vm: {error}") from None


def _run_command(request: VmRequest) -> int:
    folder = Path.cwd()
    if any(folder.is_relative_to(own) for own in _GUESTS_OWN):
        raise VmError(
            f"{folder} is not shared: the guest has its own {'/'.join(folder.parts[:2])[1:]}"
        )
    tools = programs.found_programs()
    if shutil.which(request.rest[0], path=os.environ.get("PATH", os.defpath)) is None:
        print(f"vm: {request.rest[0]}: no such command", file=sys.stderr)
        return 127
    progress = Progress(request.verbose)
    cache = kernel.cache_folder()
    ready = kernel.prepare(tools, cache, request.update, progress.say)
    job = script(job_of_caller(request.rest), tools.setpriv)

    size = Size(cpus=request.cpus, memory_mb=request.memory)
    first = accelerator.choice(request.accel, cache)
    proving = first == "kvm" and request.accel == "auto"
    limits = TimeLimits(
        request.timeout_s, accelerator.KVM_BOOT_LIMIT_S if first == "kvm" else math.inf
    )
    progress.boots(f"linux {ready.release} ({first})")
    with Machine(tools, ready, size, first) as machine:
        session = MachineSession(machine, job, limits, progress)
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
    with Machine(tools, ready, size, "tcg") as machine:
        return MachineSession(machine, job, TimeLimits(request.timeout_s), progress).run()


def _print_info(request: VmRequest) -> int:
    cache = kernel.cache_folder()
    tools = programs.found_programs()
    release = kernel.cached_release(cache)
    if release is None or request.update:
        release, packages = kernel.packages_to_fetch(tools)
        print(f"kernel       linux {release}, to be fetched: {' '.join(packages)}")
    else:
        package = (cache / release / "package").read_text().strip()
        print(f"kernel       linux {release}, in the cache: {package}")
    print(f"accelerator  {accelerator.reason(request.accel, cache)}")
    print(f"cache        {cache}")
    return Exit.OK
