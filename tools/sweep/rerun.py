"""`pcpc sweep rerun`: a run of a campaign again, with its whole log and figure, also on a bus."""

import argparse
import subprocess
import sys
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.tools.sweep import store, told

_MAIN = "from pcpc.tools.cli import main; raise SystemExit(main())"


def command(options: argparse.Namespace) -> int:
    """Simulate a run of a table; with --on-bus run it in lockstep, too, and compare the logs."""
    words = options.words[1:]
    if not 2 <= len(words) <= 3 or not words[1].isdecimal():
        raise RigError("pcpc sweep rerun: expected DIR DRAW [CONTROLLER], as runs/SWEEP 39 pd")
    folder, draw = Path(words[0]), int(words[1])
    table, spec = store.merged([folder])
    controllers = list(spec["controllers"])
    controller = words[2] if len(words) > 2 else controllers[0]
    if controller not in controllers:
        what = f"no controller {controller}{did_you_mean(controller, controllers)}"
        raise RigError(f"{folder}: {what}")
    frame = {name: table[name].to_pylist() for name in table.column_names}
    pairs = list(zip(frame["draw"], frame["controller"], strict=True))
    if (draw, controller) not in pairs:
        raise RigError(
            f"{folder}: no draw {draw}; it has {min(frame['draw'])} to {max(frame['draw'])}"
        )
    settings = told.settings_of(frame, pairs.index((draw, controller)), spec)
    about = [spec["rig"], "--controller", controller]
    about += [word for setting in settings for word in ("--set", setting)]
    output = Path(options.output or folder / f"draw-{draw}-{controller}")
    code = _pcpc("simulate", *about, "-o", str(output))
    if not options.on_bus or code not in (Exit.OK, Exit.NOT_MET, Exit.SAFETY_STOP):
        return code
    bus = output.with_name(f"{output.name}-on-bus")
    ran = _pcpc("run", *about, "--pacing", "lockstep", "-o", str(bus), "--no-figure")
    return ran if ran != code else _pcpc("log", "diff", str(output), str(bus))


def _pcpc(*words: str) -> int:
    """Run a command of pcpc in a process of its own; return its exit code."""
    return subprocess.run([sys.executable, "-c", _MAIN, *words], check=False).returncode
