"""`pcpc sweep rerun`: a run of a campaign again, with its whole log and figure, also on a bus."""

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
from pcpc.tools.after.differences import Change
from pcpc.tools.after.verdict.summary import UNFAILED
from pcpc.tools.start.folder import check_name
from pcpc.tools.study.sweep import shards
from pcpc.tools.study.sweep.campaign import Campaign
from pcpc.tools.study.sweep.commands import RerunRequest
from pcpc.tools.study.sweep.results import MARGIN, METRIC, Results

_RAN = (Exit.OK, Exit.NOT_MET, Exit.SAFETY_STOP)
_MAIN = "from pcpc.tools.cli import main; raise SystemExit(main())"


def command(request: RerunRequest) -> int:
    """Simulate a run of a table; with --on-bus run it in lockstep, too, and compare the logs.

    RigError: wrong input.
    """
    if not request.draw.isdecimal() or len(request.draw) > 18:
        raise RigError(f"{request.draw}: expected the number of a draw, as runs/SWEEP 39 pd")
    folder, draw = Path(request.folder), int(request.draw)
    check_name(request.output)
    results = Results(*shards.merge([folder], whole=False))
    controllers = list(results.spec["controllers"])
    controller = request.controller or controllers[0]
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
    output = Path(request.output or folder / f"draw-{draw}-{controller}")
    code = _pcpc("simulate", *about, "-o", str(output))
    if code in _RAN and (other := _differences(output / "summary.json", results, row)):
        print(f"{folder}: draw {draw} of {controller} came to another {', '.join(other)}")
        return Exit.NOT_MET
    if not request.on_bus or code not in _RAN:
        return code
    bus = output.with_name(f"{output.name}-on-bus")
    ran = _pcpc("run", *about, "--pacing", "lockstep", "-o", str(bus), "--no-figure")
    return ran if ran != code else _pcpc("compare", "--bits", str(output), str(bus))


def _check_unchanged(results: Results, folder: Path, about: Sequence[str]) -> None:
    """Raise RigError where rig or code are other ones than the campaign's."""
    spec = results.spec
    controllers, settings = tuple(spec["controllers"]), tuple(spec["settings"])
    now = Campaign(spec["rig"], controllers, (), 1, settings=settings)
    if changed := now.changed(spec):
        what = f"{changed} is not what it was in the campaign; as it is now"
        raise RigError(f"{folder}: {what}: {shlex.join(['pcpc', 'simulate', *about])}")


def _differences(summary: Path, results: Results, row: int) -> list[str]:
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
    others = [name for name, pair in pairs.items() if Change(name, *pair).differs]
    whole = bool(found["judged"]) and not found["not_judged"]
    ok = False if found["verdict"] not in UNFAILED else True if whole else None
    return others + ["verdict"] * bool(ok != results.column("ok")[row])


def _pcpc(*words: str) -> int:
    """Run a command of pcpc in a process of its own; return its exit code."""
    return subprocess.run([sys.executable, "-c", _MAIN, *words], check=False).returncode
