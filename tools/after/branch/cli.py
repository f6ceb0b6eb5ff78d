"""`pcpc branch LOG --cycle N`: a recorded run that goes on differently, beside its parent."""

import math
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from pcpc.drivers.can.choice import Choice, take_bus
from pcpc.drivers.errors import BusError, UserError
from pcpc.executive.durations import duration_ns
from pcpc.executive.errors import did_you_mean
from pcpc.executive.log import reader as logs
from pcpc.executive.log.provenance import RIG_COMMIT, facts
from pcpc.executive.loop.fault_kinds import WrongNode
from pcpc.executive.loop.injection import FOR_EVER
from pcpc.executive.nodes.watched import StepError
from pcpc.executive.own_laws import carried_files
from pcpc.executive.rig.buses import wanted_bus
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.standby import TO, laws
from pcpc.tools.after.branch.branching import Branch, Change
from pcpc.tools.after.branch.commands import BranchRequest
from pcpc.tools.after.branch.on_bus import BranchOnBus
from pcpc.tools.after.compare.overlay import Criteria
from pcpc.tools.after.compare.recorded import recorded_comparison
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.span import cycle_of
from pcpc.tools.after.trust import Trust
from pcpc.tools.after.verdict import summary_file
from pcpc.tools.after.verdict.conclude import conclude
from pcpc.tools.after.verdict.judge import Judge, columns_to_keep
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.after.verdict.summary import Summary
from pcpc.tools.after.verdict.virtual_end import to_end
from pcpc.tools.start.children import on_request
from pcpc.tools.start.folder import LOG, run_folder
from pcpc.tools.terminal.progress import Progress

_LEADER = "executive"


def command(request: BranchRequest) -> int:
    """Branch `request.log`, judge the new run, print how it differs; return its exit code.

    UserError: wrong input; StepError: a step hangs or raises.
    """
    path = Path(request.log)
    run = Opened(path, Trust.of(request.code))
    head = run.head
    if _LEADER not in head.node:
        raise UserError(f"{path}: no record of the executive; a branch needs all nodes")
    cycle = cycle_of(head, request.cycle, request.time)
    try:
        with run.rig(None, _of_the_rig(head, request), whole=True) as rig:
            return _run_branch(head, rig, cycle, request)
    except BusError as error:
        if request.bus is not None:
            raise
        raise UserError(str(error)) from None  # the log's DBC, not a bus of this machine
    except StepError as error:
        raise StepError(f"{path}: {error or 'a step does not return'}") from None


def _run_branch(head: logs.Log, rig: Rig, cycle: int, request: BranchRequest) -> int:
    judge = Judge.of(rig)
    judged = columns_to_keep(judge, "lockstep", not request.kept.no_figure)
    bus = None if request.bus is None else take_bus(wanted_bus(rig, rig.roles, request.bus))
    where = ("virtual", "memory") if bus is None else ("lockstep", str(bus.bus))
    outcome = Outcome(*where, strict=request.kept.judge)
    requested = _requested_changes(request)
    settled = {one.partition("=")[0] for one in requested}
    parent, doubt = summary_file.beside(head.path)
    outcome.doubt = f"{head.path}: {doubt}" if doubt else ""
    before = _settings(head, parent)
    outcome.changed = [one for one in before if one.partition("=")[0] not in settled]
    outcome.changed += requested
    progress = Progress(request.kept.quiet)
    about = _facts(head, rig, cycle, *where)
    with run_folder(request.kept.output, rig) as folder:
        run = _branch_of(bus)(head, rig, cycle, about, folder / LOG, judged)
        try:
            run.change(changes(run, rig, request))
            on_request(lambda *_: _stop(run, outcome))
            for cycles in run.before():
                progress.show(f"recomputed {cycles}/{cycle}")
            to_end(run, outcome, progress, cycle)
        except BaseException:
            run.discard()
            raise
        outcome.missing += [f"{head.path}: {line}" for line in run.missing]  # tunings, perhaps
        for line in run.notes:
            progress.say(line)
        code = conclude(judge, folder, outcome, request.kept, judged)
        if not request.kept.json:
            how = Criteria(figures=None if request.kept.no_figure else folder)
            found = recorded_comparison(str(head.path), str(folder / LOG), how, progress)
            sys.stdout.write(f"\n{found.text()}\n")
        return code


def _branch_of(bus: Choice | None) -> Callable[..., Branch]:
    if bus is None:
        return Branch
    return partial(BranchOnBus, bus=bus)


def _stop(run: Branch, outcome: Outcome) -> None:
    outcome.interrupted = True
    run.stop()


# What was asked for


def _of_the_rig(head: logs.Log, request: BranchRequest) -> list[str]:
    """Return what is asked for as settings of the rig: a longer run, one more law on standby."""
    description = head.node[_LEADER].description
    settings = [] if request.duration_s is None else [f"duration_s={request.duration_s!r}"]
    if request.controller is not None and not request.controller.strip():
        raise UserError("--controller: expected a name")
    name, there = request.controller, [str(law) for law in description.get("laws", ())]
    own = head.metadata[_LEADER].get("controller", "")
    if name is not None and name not in (own, *there):
        settings.append(f"standby=[{','.join([*there[1:], name])}]")
    return settings


def _requested_changes(request: BranchRequest) -> list[str]:
    """Return in words what is different."""
    described = [f"fault {text}" for text in request.fault]
    described += [] if request.controller is None else [f"controller={request.controller}"]
    described += [] if request.duration_s is None else [f"duration_s={request.duration_s:g}"]
    return described


def _settings(head: logs.Log, parent: Summary | None) -> list[str]:
    """Return what the command of a run had changed; its tunings are in its log."""
    tunable = {name for node in head.node.values() for name in node.description.get("ranges", ())}
    return [one for one in parent.changed if one.partition("=")[0] not in tunable] if parent else []


def _facts(head: logs.Log, rig: Rig, cycle: int, pacing: str, bus: str) -> dict[str, str]:
    """Return the facts of the new log, its parent among them."""
    config, parent = rig.config, head.metadata[_LEADER]
    commit = {RIG_COMMIT: parent[RIG_COMMIT]} if RIG_COMMIT in parent else {}
    return facts() | commit | {
        "pacing": pacing, "bus": bus, "controller": config.controller,
        "seed": str(config.seed), "rate_hz": repr(config.rate_hz),
        "branch_of": str(head.path.resolve()), "branch_sha256": carried_files.sha256(head.path),
        "branch_cycle": str(cycle),
    }  # fmt: skip


def changes(run: Branch, rig: Rig, request: BranchRequest) -> list[Change]:
    """Return what is to be set in which node; UserError for what no node takes."""
    known = run.parameters()
    wanted = [_setting(known, text) for text in request.set]
    for text in request.fault:
        wanted += _fault_changes(run, rig, text)
    if request.controller is not None:
        wanted.append(_handover_change(rig, request.controller))
    names = [(one.role, one.name) for one in wanted]
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"{name[1]}: given twice")
    return wanted


def _setting(known: Mapping[str, Mapping[str, Any]], text: str) -> Change:
    """Return the change that `--set` asks for: [NODE:]NAME=VALUE."""
    word, equals, number = text.partition("=")
    role, colon, name = word.rpartition(":")
    if not (equals and name):
        raise UserError(f"--set {text!r}: expected NAME=VALUE")
    if colon and role not in known:
        raise UserError(f"--set {text}: no node {role}; known: {', '.join(known)}")
    roles = [one for one in known if name in known[one] and role in ("", one)]
    if not roles:
        among = [name for one in known if role in ("", one) for name in known[one]]
        what = f"--set {text}: no parameter {name}{did_you_mean(name, among)}"
        raise UserError(f"{what}; a branch sets parameters that `pcpc set` would")
    try:
        value = float(number)
    except ValueError:
        raise UserError(f"--set {text}: {number!r} is not a number") from None
    variable = known[roles[0]][name]
    if not (math.isfinite(value) and variable.low <= value <= variable.high):
        raise UserError(f"--set {text}: outside {variable.low:g}..{variable.high:g}")
    return Change(roles[0], name, value)


def _fault_changes(run: Branch, rig: Rig, text: str) -> list[Change]:
    """Return the changes that begin a fault of the rig in the nodes that have it.

    As `ActingFault.moments`: what acts on frames is set in the cycle before.
    """
    name, _, length = text.partition(":")
    if name not in rig.config.faults:
        cure = did_you_mean(name, rig.config.faults) if rig.config.faults else ""
        raise UserError(f"--fault {text}: no such fault{cure or '; its rig has no faults'}")
    if rig.config.faults[name].kind == WrongNode.STALL.word:
        raise UserError(f"--fault {text}: a stall on demand has no effect without a clock")
    cycles_left = FOR_EVER
    if length:
        try:
            cycles_left = float(round(duration_ns(length) * 1e-9 * rig.config.rate_hz))
        except ValueError as error:
            raise UserError(f"--fault {text}: {error}") from None
    return [
        Change(made.role, f"fault.{name}.left", cycles_left, int(acting.acts_later))
        for made in run.plans
        for acting in made.faults
        if acting.name == name
    ]


def _handover_change(rig: Rig, name: str) -> Change:
    """Return the change by which a controller takes over."""
    names = laws(rig.config)
    if len(names) == 1:
        raise UserError(f"--controller {name}: it is the controller of this run already")
    return Change(_LEADER, TO, float(names.index(name)))
