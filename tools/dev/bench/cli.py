"""`python -m pcpc.tools.dev.bench`: ratios against a yardstick, measured interleaved in one run.

Several suites are measured in a process each: what one compiles, and for which processor, is not
what another one runs on. What is missing for a suite is named before the first one begins.
"""

import json
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import BusError, Exit, UserError
from pcpc.executive.errors import did_you_mean
from pcpc.tools.dev.bench.options import NEEDS, SUITES, BenchRequest
from pcpc.tools.machine.jitter.compiler import BenchError, find
from pcpc.tools.start.native import native
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.extras import need
from pcpc.tools.terminal.progress import Progress

ON_REQUEST = ("host", "startup", "batch")  # one to three minutes each


def command(request: BenchRequest) -> int:
    """Measure suites and print their ratios; ENVIRONMENT where a yardstick is missing."""
    if unknown := [name for name in request.names if name not in SUITES]:
        raise UserError(f"{unknown[0]}: no such suite{did_you_mean(unknown[0], SUITES)}")
    if request.rounds < 1:
        raise UserError(f"--rounds {request.rounds}: expected 1 or more")
    names = list(request.names) or [name for name in SUITES if name not in ON_REQUEST]
    missing = {name: reason for name in names if (reason := _missing(name))}
    for reason in sorted(set(missing.values())):
        of = " ".join(name for name in missing if missing[name] == reason)
        print(f"not measured: {of}: {reason}", file=sys.stderr)
    names = [name for name in names if name not in missing]
    if len(names) == 1:
        found, code = _measured_suite(names[0], request)
    else:
        found, code = _in_processes(names, request)
    if request.json:
        try:
            request.json.write_text(screen.json_text(found) + "\n")
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(request.json)) from None
    return Exit.ENVIRONMENT if missing else code


def _missing(name: str) -> str:
    """Return which yardsticks of a suite are not here, and the cure; "" if all are."""
    try:
        for needed in NEEDS.get(name, ("cc",)):
            if needed == "cc":
                find()
            else:
                need("it needs", needed)
    except UserError as error:
        return str(error)
    return ""


def _measured_suite(name: str, request: BenchRequest) -> tuple[list[Any], int]:
    """Measure one suite; return its ratios as JSON has them, and the exit code."""
    progress = Progress(request.quiet)
    with native(name == "batch"):  # as `pcpc sweep`
        suite = import_module(f"pcpc.tools.dev.bench.{name}")
        try:
            ratios = suite.measure(progress, request.rounds)
        except (BenchError, BusError) as error:
            progress.close()
            print(f"{name}: {error}", file=sys.stderr)
            return [], Exit.ENVIRONMENT
    progress.close()
    for ratio in ratios:
        print(ratio)
    return [vars(ratio) for ratio in ratios], Exit.OK


def _in_processes(names: list[str], request: BenchRequest) -> tuple[list[Any], int]:
    """Measure suites one after the other, each in a process of its own; as `_measured_suite`."""
    found, code = [], 0
    with tempfile.TemporaryDirectory(prefix="pcpc-bench-") as folder:
        for name in names:
            table = Path(folder) / f"{name}.json"
            words = [name, "--rounds", str(request.rounds), "--json", str(table)]
            words += ["--quiet"] * request.quiet
            command = [sys.executable, "-P", "-m", "pcpc.tools.dev.bench", *words]
            ended = subprocess.run(command, check=False).returncode
            code = max(code, ended if ended >= 0 else Exit.ENVIRONMENT)
            if table.is_file():
                found += json.loads(table.read_text())
    return found, code
