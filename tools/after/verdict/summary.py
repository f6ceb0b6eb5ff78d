"""What a run came to: metrics, timing, frames, verdict; as summary.json. As text: report.py.

verdict              exit code
ok                   0    no metric is outside the rig's limits, no requirement is violated, and one
                          of them at least was judged, if it states any
not judged           1    the rig states limits or requirements, and none of them was judged
expectation not met  1    a metric is outside the rig's two-sided limits, a requirement is violated,
                          the evaluation failed, the master of a drive made a mistake, or somebody
                          else ended the run too early
loss                 3    frames lost (but not on purpose) or stale, slow ones that stayed away,
                          more wrong ones than the rig's `errors` allow, records dropped, or a part
                          of the log missing
safety stop          5    a node faulted or died
interrupted          130  Ctrl-C

Counters are those of the nodes at their end, not of what the log keeps.
"""

import contextlib
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import UNSET, Meta, UnsetType

from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.executive.log.provenance import RIG_COMMIT
from pcpc.executive.nodes.planned_plausible import COUNT
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.verdict import on_purpose
from pcpc.tools.after.verdict.findings import (
    JUDGED,
    LINES,
    NOT_JUDGED,
    Finding,
    FindingKind,
    lines,
    verdict_of,
)
from pcpc.tools.after.verdict.frames import (
    absence_lines,
    frames_to,
    most_clipped_signal,
    too_many,
    unlike,
)
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.after.verdict.latest import level
from pcpc.tools.after.verdict.masters import mistakes
from pcpc.tools.after.verdict.outcome import HEALTH, Outcome, warnings_of
from pcpc.tools.after.verdict.records import dropped_rows, missing_lines, records
from pcpc.tools.after.verdict.requirements import LEADER, JudgedRequirement, ends_early
from pcpc.tools.after.verdict.timing import stage_percentiles
from pcpc.tools.terminal.answer import Number

UNFAILED = "ok", NOT_JUDGED  # verdicts against which nothing speaks
CODES = {code.meaning: code for code in Exit} | {NOT_JUDGED: Exit.NOT_MET}
Counts = dict[str, int]
_COMMIT = Meta(
    extra_json_schema={"pattern": "^([0-9a-f]{12}(-dirty)?)?$", "optional": True},
)
_LEVEL = Meta(extra_json_schema={"enum": ["", "OK", "WARN", "ERROR", NOT_JUDGED]})
_VERDICT = Meta(extra_json_schema={"enum": [*CODES]})


class Summary(msgspec.Struct, kw_only=True, dict=True):
    """What a run came to; summary.json has the same keys in this order.

    What an older file does not tell is what nothing happened of. `findings`, of which `enter` makes
    the keys that tell of them, are not in the file, and [] of what was read from one.
    """

    rig: str = ""
    "its name"
    title: str = ""
    controller: str = ""
    pacing: str = ""
    "virtual, lockstep, sync or real"
    bus: str = ""
    "memory: none"
    seed: int = 0
    rate_hz: Number = 0.0
    "Hz"
    rig_git: Annotated[str, _COMMIT] = ""
    "commit of the rig's work tree, with -dirty where files differ from it; empty: none"
    cycles: int = 0
    late_cycles: int = 0
    skipped_cycles: int = 0
    held_cycles: int = 0
    metrics: dict[str, Number]
    "by name, which ends with the unit"
    timing_us: dict[str, dict[str, Number]] = {}
    "of the executive, by stage and percentile, us"
    timing_level: Annotated[str, _LEVEL] = ""
    """of timing_share and of skipped and held periods, by the limits of the rig; empty: an earlier
    version wrote it"""
    timing_share: Number = 0.0
    "of a period, at p99.9"
    latest_cycles: list[dict[str, Any]] = []  # see `latest.latest_cycles`
    frames: Counts = {}  # of all nodes, see `outcome.HEALTH`
    frames_too_many: list[str] = []
    "in words"
    lost: list[str] = []
    "input that nothing took on purpose, and rows of the log, in words"
    warned: list[str] = []
    "FMUs that warned and went on, in words"
    most_cut: str = ""
    frames_to: dict[str, Counts] = {}
    "by node"
    records: dict[str, int | bool] = {}
    faults: list[str] = []
    "in words"
    injected: list[str] = []
    "faults on purpose, in words"
    changed: list[str] = []
    "what was set while it ran, in words"
    judged: list[str] = []
    "metrics that the rig limits"
    not_judged: dict[str, str] = {}
    "why not, by metric"
    expectations_failed: list[str] = []
    "in words"
    requirements: list[JudgedRequirement] = []
    realtime: bool | None = None
    "whether SCHED_FIFO was granted; null: no clock ran"
    start_to_first_cycle_s: Number | None = None
    "s; null: not known"
    log_missing: list[str] = []
    "in words"
    verdict: Annotated[str, _VERDICT]
    ids: dict[str, str] | UnsetType = UNSET
    "of what the rig limits, by metric; only where it gives some"
    device: dict[str, Any] | UnsetType = UNSET
    "only of a run with a device"
    bound: dict[str, str] | UnsetType = UNSET
    "SHA-256 of log, figure and this summary, by file"

    def __post_init__(self) -> None:
        self.findings: list[Finding] = []
        self.is_branch = False

    def problems(self) -> list[str]:
        """Return what keeps a run from being ok, a line each."""
        return [
            *self.faults, *self.expectations_failed, *self.lost, *self.frames_too_many,
            *self.log_missing, *(self.reasons() if self.verdict == NOT_JUDGED else ()),
        ]  # fmt: skip

    def reasons(self) -> list[str]:
        """Return those problems that the verdict is of, a line each; [] of one that is ok."""
        of = {
            NOT_JUDGED: [*dict.fromkeys(self.not_judged.values())],
            "safety stop": self.faults,
            "loss": [*self.lost, *self.frames_too_many, *self.log_missing],
            "expectation not met": self.expectations_failed,
            "interrupted": [f"asked to end in cycle {self.cycles:,} (Ctrl-C or a signal)"],
        }
        return of.get(self.verdict, [])

    def named(self, limit: str) -> str:
        """Return the name of a limit behind its id, if it has one."""
        ids = self.ids or {}
        return f"{ids[limit]} {limit}" if limit in ids else limit

    def enter(self, *findings: Finding) -> None:
        """Enter what speaks for or against the run; the gravest of it is the verdict."""
        self.findings += findings
        for finding in findings:
            if finding.held is None:
                self.not_judged[finding.key] = finding.why
            elif finding.kind in JUDGED:
                self.judged.append(finding.key)
            if finding.held is False and (key := LINES[finding.kind][0]):
                getattr(self, key).append(str(finding))
        self.verdict = verdict_of(findings, self.verdict)
        limits = [one for one in self.judged if one != FindingKind.TIMING or one in self.metrics]
        limits += [one.name for one in self.requirements if one.held is not None]
        if self.verdict == "ok" and self.not_judged and not limits:
            self.verdict = NOT_JUDGED

    def note_missing(self, path: Path, error: OSError) -> None:
        """Enter a file of the run that could not be written."""
        why = f"{path}: cannot be written: {error.strerror or error}"
        self.enter(*lines(FindingKind.LOG, [why]))
        with contextlib.suppress(OSError):  # a part of a file is worse than none
            path.unlink()


def outcome_of(log: logs.Log, doubt: str = "") -> Outcome:
    """Return what a log alone tells of its run: its faults, and whether it came to its end.

    `doubt`: of what lies beside it.
    """
    facts = log.metadata.get(LEADER, {})
    outcome = Outcome(facts.get("pacing", ""), facts.get("bus", ""), doubt=doubt)
    for name, node in log.node.items():
        for event in node.events:
            if event.get("event") == "fault":
                what = event.get("name") or event.get("argument", "")
                outcome.faults.append(f"{name}: {what}, cycle {event.get('cycle')}")
    leader = log.node.get(LEADER)
    if leader is None or log.metadata.get("run", {}).get("discarded", "0") != "0":
        return outcome
    done = int(leader.cycle[-1]) + 1 if len(leader.cycle) else 0
    about = leader.description
    if ends_early(log, done - 1, 1e-9 * about.get("period_ns", 0)):
        outcome.short = f"{done:,} of {about['cycles']:,} cycles: the log ends before"
    return outcome


def summarise(rig: Rig, log: logs.Log, outcome: Outcome, judge: Judge | None = None) -> Summary:
    """Return the content of summary.json."""
    executive = log.node.get(LEADER)
    executive = executive if executive and len(executive.cycle) else None
    each = _each_health(log, outcome)
    health = _sum(each)
    cycles = max(int(executive.cycle[-1]) + 1 if executive else 0, outcome.cycles)
    changed = [*dict.fromkeys((*branch_lines(log), *outcome.changed, *_live_tunings(rig, log)))]
    judge = judge or Judge.of(rig)
    early = outcome.interrupted or outcome.faults or outcome.short
    judgement = judge.judge(log, changed, "the run did not finish" if early else "")
    missed = on_purpose.missed_by_the_machine(rig, log, health)
    timing = stage_percentiles(executive, log, outcome, missed[0])
    worst_us = timing.pop("together", {})
    timing_level, share = level(worst_us, rig.config.rate_hz, rig.config.timing, missed, cycles)
    summary = Summary(
        rig=rig.config.rig,
        title=rig.config.title,
        controller=rig.config.controller,
        pacing=outcome.pacing,
        bus=outcome.bus,
        seed=rig.config.seed,
        rate_hz=rig.config.rate_hz,
        rig_git=log.metadata.get(LEADER, {}).get(RIG_COMMIT, ""),
        cycles=cycles,
        late_cycles=health.pop("late_cycles"),
        skipped_cycles=health.pop("skipped_cycles"),
        held_cycles=health.pop("held_cycles"),
        metrics=judgement.metrics,
        timing_us=timing,
        timing_level=timing_level,
        timing_share=round(share, 4),
        latest_cycles=outcome.latest,
        frames=health,
        warned=warnings_of(log.node),
        most_cut=most_clipped_signal(rig, log) if health["saturated_values"] else "",
        frames_to=frames_to(rig, log, each),
        records=records(rig, log, outcome),
        injected=on_purpose.started_faults(log),
        changed=changed,
        requirements=judgement.requirements,
        realtime=outcome.realtime,
        start_to_first_cycle_s=_start_s(executive, outcome),
        verdict="ok",
        ids=rig.config.limit_ids() or UNSET,
    )
    summary.is_branch = bool(branch_lines(log))
    limited = bool(timing) and rig.config.timing.error is not None
    timed = [_timing_finding(rig, share, missed[0], timing_level)] if limited else []
    summary.enter(
        *_unmet_findings(log, outcome, judgement.findings, timed),
        *lines(FindingKind.INPUT, _lost_lines(log, outcome, each)),
        *lines(
            FindingKind.FRAMES, [*too_many(rig, health), *absence_lines(rig, log), *unlike(log)]
        ),
        *lines(FindingKind.LOG, missing_lines(executive, log, outcome)),
        *lines(FindingKind.SUMMARY, [outcome.doubt] * bool(outcome.doubt)),
        *lines(FindingKind.FAULT, outcome.faults),
        *lines(FindingKind.STOP, ["asked to end"] * outcome.interrupted),
    )
    return summary


def _timing_finding(rig: Rig, share: float, skipped: int, level_word: str) -> Finding:
    """Return what became of the limit of lateness and work."""
    limit, held = rig.config.timing.error, level_word != "ERROR"
    line = f"lateness and work at p99.9 are {share:.2f} of a period, limit {limit}"
    why = line + f"; {skipped:,} periods were skipped" * (skipped > 0)
    return Finding(
        FindingKind.TIMING, "" if held else why, held, value=share, high=limit or math.inf
    )


def _unmet_findings(
    log: logs.Log, outcome: Outcome, judged: list[Finding], timed: list[Finding]
) -> list[Finding]:
    """Return what was `judged` and `timed`, and what was not met besides."""
    masters = [line for node in log.node.values() for line in mistakes(node)]
    findings = [*judged, *lines(FindingKind.MASTER, masters), *timed]
    if outcome.short and not (outcome.interrupted or outcome.faults):
        findings += lines(FindingKind.END, [outcome.short])
    if outcome.strict:
        left = dict.fromkeys(str(one) for one in findings if one.held is None)
        left |= dict.fromkeys(
            ["nothing was judged"] * all(one.kind not in JUDGED for one in findings)
        )
        findings += lines(FindingKind.STRICT, left)
    return findings


def _lost_lines(log: logs.Log, outcome: Outcome, each: Mapping[str, Counts]) -> list[str]:
    """Return what was lost: input that nothing took on purpose, rows of the log."""
    lost = on_purpose.missing_input(log, each)
    lost += [outcome.stall] * bool(lost and outcome.stall)
    dropped = dropped_rows(log, outcome)
    return lost + [f"{dropped:,} rows found a ring full and are not in the log"] * bool(dropped)


def branch_lines(log: logs.Log) -> list[str]:
    """Return of which log a run is a branch, and where it begins; [] if it is none."""
    facts = log.metadata.get(LEADER, {})
    if "branch_of" not in facts:
        return []
    parent = Path(facts["branch_of"])
    return [f"branch at cycle {facts.get('branch_cycle')} of {parent.parent.name}/{parent.name}"]


def _live_tunings(rig: Rig, log: logs.Log) -> list[str]:
    """Return the live tunings of a run, NAME=VALUE; those of the rig's schedule are none."""
    planned = [(name, value) for entry in rig.config.schedule for name, value in entry.set.items()]
    last: dict[str, str] = {}
    for node in log.node.values():
        for tuning in node.tunings:
            name, value = tuning["name"], float(tuning["value"])
            if name.startswith("fault.") and name.endswith(".left"):
                continue  # told with the faults on purpose
            if (name, value) in planned:
                planned.remove((name, value))
            else:
                last[name] = f"{name}={value:g}"
    return list(last.values())


def _start_s(executive: logs.NodeLog | None, outcome: Outcome) -> float | None:
    """Return the time from the command to the executive's first cycle."""
    if executive is None or outcome.begin_ns is None:
        return None
    first_ns = int(executive.stamp_ns[0])
    if outcome.pacing == "lockstep":  # its stamps are k T
        ahead_ns = time.time_ns() - time.monotonic_ns()
        first_ns = round(1e9 * float(executive.timing["timing.wall_s"][0])) - ahead_ns
    return round(1e-9 * (first_ns - outcome.begin_ns), 2)


def _each_health(log: logs.Log, outcome: Outcome) -> dict[str, dict[str, int]]:
    """Return the counters of each node: its own ones if it ran here, else the last in the log."""
    health = dict(outcome.health)
    for role, node in log.node.items():
        if role not in health:
            wanted = [f"health.{name}" for _, name in HEALTH.values()]
            wanted += [name for name in node.columns if name.startswith(COUNT)]
            health[role] = counters(
                {
                    name: columns[name][-1]
                    for columns in (node.timing, node.columns)
                    for name in wanted
                    if name in columns and len(columns[name])
                }
            )
    return health


def counters(last: Mapping[str, float]) -> Counts:
    """Return the counters of a node by the last values of its columns."""
    found = {key: int(last.get(f"health.{name}", 0)) for key, (_, name) in HEALTH.items()}
    refused = (int(value) for name, value in last.items() if name.startswith(COUNT))
    return found | {"implausible": sum(refused)}


def _sum(each: dict[str, Counts]) -> Counts:
    """Return the counters of all nodes added up; those of cycles are the executive's."""
    return {
        key: sum(
            counters.get(key, 0)
            for role, counters in each.items()
            if role == "executive" or not key.endswith("_cycles")
        )
        for key in HEALTH
    }
