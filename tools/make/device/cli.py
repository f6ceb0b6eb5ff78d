"""`pcpc plant`: the emulator for an executive elsewhere or, with --device, for a device.

With a device the log is kept here, and judged: the plant's record by the rig's limits and
requirements, the device by what it sent. docs/device.md is what a device has to do.
"""

import argparse
import os
import sys
from pathlib import Path

from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.make.device.host import DeviceHost, check
from pcpc.tools.start import pace
from pcpc.tools.start.folder import LOG, run_folder

_CYCLES = "late_cycles", "skipped_cycles", "held_cycles"  # the plant's own


def command(options: argparse.Namespace) -> int:
    """Carry out `plant`; return the exit code."""
    rig = load_rig(options.rig, options.controller, options.set, resolve=False)
    options, said = pace.settle(options, rig, alone=True)
    check(rig, options.pacing or rig.config.pacing)
    if said:
        print(said, file=sys.stderr)
    with run_folder(options.output, rig) as folder:
        host = DeviceHost(options, rig, folder)
        with host.page:
            code = host.run()
            if code >= 0:
                os.truncate(folder / LOG, 0)
                return code
            code = _conclude(host, rig, folder, options)
            host.page.farewell(folder)
            return code


def _conclude(host: DeviceHost, rig: Rig, folder: Path, options: argparse.Namespace) -> int:
    """Read the log back, judge plant and device, print; return the exit code of the verdict."""
    from pcpc.tools.after.verdict import summary as summaries  # time
    from pcpc.tools.after.verdict.conclude import publish, unreadable
    from pcpc.tools.after.verdict.judge import EvaluationError
    from pcpc.tools.make.device.age import note_ages
    from pcpc.tools.make.device.behaviour import behaviour
    from pcpc.tools.make.device.record import judge_of_device, run_of_device

    outcome = host.outcome
    try:
        log = run_of_device(rig, logs.read(folder / LOG), outcome.pacing)
    except logs.LogError as error:
        return unreadable(outcome, error)
    judge, left = judge_of_device(host.judge, log)
    found = behaviour(rig, log, outcome.pacing, host.counts)
    note_ages(found, rig, log, outcome.pacing)
    summary = summaries.summarise(judge.rig, log, outcome, judge)
    summary.controller, summary.ids = "device", rig.config.limit_ids() or summary.ids
    summary.device = {"command": options.device, **found.json()}
    for key in _CYCLES:
        setattr(summary, key, outcome.health.get(host.leader, {}).get(key, 0))
    summary.not_judged |= left
    summary.warned += found.warned
    own, summary.expectations_failed = summary.expectations_failed, []
    summary.note_failed(found.problems)
    summary.expectations_failed += own
    if outcome.strict:
        summary.note_failed([f"{name} was not judged: {why}" for name, why in left.items()])
    if not options.no_figure and rig.evaluation is not None:
        try:
            judge.draw(log, summary.metrics, folder / "figure.png", who="a device")
        except (EvaluationError, OSError) as error:
            print(f"no figure: {error}", file=sys.stderr)
    return publish(summary, folder, options)
