"""`pcpc sweep rerun`: a run of a campaign again, with its whole log and figure, also on a bus."""

import argparse
import json
import math
import shlex
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.tools.start.folder import check_name
from pcpc.tools.study.sweep import shards, told
from pcpc.tools.study.sweep.campaign import Campaign, differences
from pcpc.tools.study.sweep.results import METRIC

_RAN = (Exit.OK, Exit.NOT_MET, Exit.SAFETY_STOP)
_MAIN = "from pcpc.tools.cli import main; raise SystemExit(main())"


def command(options: argparse.Namespace) -> int:
    """Simulate a run of a table; with --on-bus run it in lockstep, too, and compare the logs."""
    words = options.words[1:]
    if not 2 <= len(words) <= 3 or not words[1].isdecimal() or len(words[1]) > 18:
        raise RigError("pcpc sweep rerun: expected DIR DRAW [CONTROLLER], as runs/SWEEP 39 pd")
    folder, draw = Path(words[0]), int(words[1])
    check_name(options.output)
    table, spec = shards.merged([folder], whole=False)
    controllers = list(spec["controllers"])
    controller = words[2] if len(words) > 2 else controllers[0]
    if controller not in controllers:
        what = f"no controller {controller}{did_you_mean(controller, controllers)}"
        raise RigError(f"{folder}: {what}")
    frame = {name: table[name].to_pylist() for name in table.column_names}
    pairs = list(zip(frame["draw"], frame["controller"], strict=True))
    if (draw, controller) not in pairs:
        there = f"it has {min(frame['draw'])} to {max(frame['draw'])}" if pairs else "it has none"
        raise RigError(f"{folder}: no draw {draw} of {controller}; {there}")
    row = pairs.index((draw, controller))
    settings = told.settings_of(frame, row, spec)
    about = [spec["rig"], "--controller", controller]
    about += [word for setting in settings for word in ("--set", setting)]
    campaign = Campaign(spec["rig"], tuple(controllers), (), 1, settings=tuple(spec["settings"]))
    if differ := differences({**spec, "origin": campaign.spec()["origin"]}, spec):
        again = shlex.join(["pcpc", "simulate", *about])
        what = f"{differ} is not what it was in the campaign; as it is now"
        raise RigError(f"{folder}: {what}: {again}")
    output = Path(options.output or folder / f"draw-{draw}-{controller}")
    code = _pcpc("simulate", *about, "-o", str(output))
    if code in _RAN and (other := _others(output / "summary.json", frame, row)):
        print(f"{folder}: draw {draw} of {controller} came to another {', '.join(other)}")
        return Exit.NOT_MET
    if not options.on_bus or code not in _RAN:
        return code
    bus = output.with_name(f"{output.name}-on-bus")
    ran = _pcpc("run", *about, "--pacing", "lockstep", "-o", str(bus), "--no-figure")
    return ran if ran != code else _pcpc("log", "diff", str(output), str(bus))


def _others(summary: Path, frame: Mapping[str, Any], row: int) -> list[str]:
    """Return the metrics of a run that are others than those of a row."""
    metrics = json.loads(summary.read_text(encoding="utf-8"))["metrics"]
    return [
        name.removeprefix(METRIC)
        for name in frame
        if name.startswith(METRIC)
        and _number(frame[name][row]) != _number(metrics.get(name.removeprefix(METRIC)))
    ]


def _number(value: float | None) -> float | None:
    """Return a metric, None where it was not told."""
    return None if value is None or math.isnan(value) else value


def _pcpc(*words: str) -> int:
    """Run a command of pcpc in a process of its own; return its exit code."""
    return subprocess.run([sys.executable, "-c", _MAIN, *words], check=False).returncode
