"""`pcpc sweep rerun`: a run of a campaign again, with its whole log and figure, also on a bus."""

import argparse
import json
import math
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.tools.start.folder import check_name
from pcpc.tools.study.engine import FAULT
from pcpc.tools.study.sweep import shards
from pcpc.tools.study.sweep.campaign import Campaign
from pcpc.tools.study.sweep.results import MARGIN, METRIC, Results

_RAN = (Exit.OK, Exit.NOT_MET, Exit.SAFETY_STOP)
_MAIN = "from pcpc.tools.cli import main; raise SystemExit(main())"


def command(options: argparse.Namespace) -> int:
    """Simulate a run of a table; with --on-bus run it in lockstep, too, and compare the logs.

    RigError: wrong input.
    """
    words = options.words[1:]
    if not 2 <= len(words) <= 3 or not words[1].isdecimal() or len(words[1]) > 18:
        raise RigError("pcpc sweep rerun: expected DIR DRAW [CONTROLLER], as runs/SWEEP 39 pd")
    folder, draw = Path(words[0]), int(words[1])
    check_name(options.output)
    results = Results(*shards.merge([folder], whole=False))
    controllers = list(results.spec["controllers"])
    controller = words[2] if len(words) > 2 else controllers[0]
    if controller not in controllers:
        what = f"no controller {controller}{did_you_mean(controller, controllers)}"
        raise RigError(f"{folder}: {what}")
    draws = results.column("draw")
    found = np.flatnonzero((draws == draw) & (results.column("controller") == controller))
    if not len(found):
        there = f"it has {draws.min()} to {draws.max()}" if len(draws) else "it has none"
        raise RigError(f"{folder}: no draw {draw} of {controller}; {there}")
    row = int(found[0])
    about = results.run_words(row)
    _check_unchanged(results, folder, about)
    output = Path(options.output or folder / f"draw-{draw}-{controller}")
    code = _pcpc("simulate", *about, "-o", str(output))
    if code in _RAN and (other := _differences(output / "summary.json", code, results, row)):
        print(f"{folder}: draw {draw} of {controller} came to another {', '.join(other)}")
        return Exit.NOT_MET
    if not options.on_bus or code not in _RAN:
        return code
    bus = output.with_name(f"{output.name}-on-bus")
    ran = _pcpc("run", *about, "--pacing", "lockstep", "-o", str(bus), "--no-figure")
    return ran if ran != code else _pcpc("log", "diff", str(output), str(bus))


def _check_unchanged(results: Results, folder: Path, about: Sequence[str]) -> None:
    """Raise RigError where rig or code are other ones than the campaign's."""
    spec = results.spec
    controllers, settings = tuple(spec["controllers"]), tuple(spec["settings"])
    now = Campaign(spec["rig"], controllers, (), 1, settings=settings)
    if changed := now.changed(spec):
        what = f"{changed} is not what it was in the campaign; as it is now"
        raise RigError(f"{folder}: {what}: {shlex.join(['pcpc', 'simulate', *about])}")


def _differences(summary: Path, code: int, results: Results, row: int) -> list[str]:
    """Return the metrics and margins of a run that are others than a row's, and the verdict."""
    found = json.loads(summary.read_text(encoding="utf-8"))
    now = {METRIC + name: value for name, value in found["metrics"].items()}
    now |= {MARGIN + one["name"]: one["margin"] for one in found["requirements"]}

    def number(value: float | str | None) -> float:
        return math.nan if value is None else float(value)  # "inf" is text in JSON

    pairs = {
        name.partition(":")[2]: (float(results.column(name)[row]), number(now.get(name)))
        for name in results.measures
    }
    others = [name for name, pair in pairs.items() if not np.array_equal(*pair, equal_nan=True)]
    ok, fault = results.column("ok")[row], results.column("outcome")[row] == FAULT
    failed = fault or (ok is not None and not ok)
    return others + ["verdict"] * (failed != (code != Exit.OK))


def _pcpc(*words: str) -> int:
    """Run a command of pcpc in a process of its own; return its exit code."""
    return subprocess.run([sys.executable, "-c", _MAIN, *words], check=False).returncode
