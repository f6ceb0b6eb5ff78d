"""`pcpc run --device`: the emulator for a device in the executive's place.

With a device the log is kept here, and judged: the plant's record by the rig's limits and
requirements, the device by what it sent. docs/device.md is what a device has to do.
"""

import os
import sys
from pathlib import Path

from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.after.opened import Opened
from pcpc.tools.make.device.host import DeviceHost, check
from pcpc.tools.run.commands import RunRequest
from pcpc.tools.start import pace
from pcpc.tools.start.folder import LOG, run_folder

_CYCLES = "late_cycles", "skipped_cycles", "held_cycles"  # the plant's own


def command(request: RunRequest) -> int:
    """Carry out `run --device`; return the exit code."""
    rig = load_rig(request.rig, request.controller, request.set, resolve=False)
    pacing, said = pace.settle(request.pacing, rig, alone=True)
    request = request.changed(pacing=pacing)
    check(rig, request.pacing or rig.config.pacing)
    if said:
        print(said, file=sys.stderr)
    with run_folder(request.kept.output, rig) as folder:
        host = DeviceHost(request, rig, folder)
        with host.page:
            code = host.run()
            if code >= 0:
                os.truncate(folder / LOG, 0)
                return code
            code = _conclude(host, rig, folder)
            host.page.farewell(folder)
            return code


def _conclude(host: DeviceHost, rig: Rig, folder: Path) -> int:
    """Read the log back, judge plant and device, print; return the exit code of the verdict."""
    from pcpc.tools.after.verdict import summary as summaries  # time
    from pcpc.tools.after.verdict.conclude import publish, unreadable
    from pcpc.tools.after.verdict.findings import FindingKind, lines
    from pcpc.tools.after.verdict.judge import EvaluationError
    from pcpc.tools.make.device.age import note_ages
    from pcpc.tools.make.device.behaviour import behaviour
    from pcpc.tools.make.device.record import judge_of_device, run_of_device

    outcome = host.outcome
    try:
        log = run_of_device(rig, Opened(folder / LOG).log, outcome.pacing)
    except logs.LogError as error:
        return unreadable(outcome, error)
    judge, left = judge_of_device(host.judge, log)
    found = behaviour(rig, log, outcome.pacing, host.counts)
    note_ages(found, rig, log, outcome.pacing)
    summary = summaries.summarise(judge.rig, log, outcome, judge)
    summary.controller, summary.ids = "device", rig.config.limit_ids() or summary.ids
    summary.device = {"command": host.command, **found.json()}
    for key in _CYCLES:
        setattr(summary, key, outcome.health.get(host.leader, {}).get(key, 0))
    summary.enter(*left)
    summary.warned += found.warned
    own, summary.expectations_failed = summary.expectations_failed, []
    summary.enter(*lines(FindingKind.DEVICE, found.problems))
    summary.expectations_failed += own
    if outcome.strict:
        summary.enter(
            *lines(FindingKind.STRICT, (f"{one.key} was not judged: {one.why}" for one in left))
        )
    if not host.request.kept.no_figure and rig.evaluation is not None:
        try:
            judge.draw(log, summary.metrics, folder / "figure.png", who="a device")
        except (EvaluationError, OSError) as error:
            print(f"no figure: {error}", file=sys.stderr)
    return publish(summary, folder, host.request.kept)
