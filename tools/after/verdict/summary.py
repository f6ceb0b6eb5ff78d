"""What a run came to: metrics, timing, frames, verdict; as summary.json. As text: report.py.

verdict              exit code
ok                   0
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
import re
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.executive.log.provenance import RIG_COMMIT
from pcpc.executive.nodes.planned_plausible import COUNT
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.verdict import on_purpose
from pcpc.tools.after.verdict.frames import (
    absence_lines,
    frames_to,
    most_clipped_signal,
    too_many,
    unlike,
)
from pcpc.tools.after.verdict.judge import Judge, Judgement
from pcpc.tools.after.verdict.latest import level
from pcpc.tools.after.verdict.masters import mistakes
from pcpc.tools.after.verdict.outcome import HEALTH, Outcome, warnings_of
from pcpc.tools.after.verdict.requirements import LEADER, Result, ends_early
from pcpc.tools.after.verdict.timing import stage_percentiles

CODES = {code.meaning: code for code in Exit}
Counts = dict[str, int]


class Summary(msgspec.Struct, kw_only=True):
    """What a run came to; summary.json has the same keys in this order.

    What an older file does not tell is what nothing happened of.
    """

    rig: str = ""
    title: str = ""
    controller: str = ""
    pacing: str = ""
    bus: str = ""
    seed: int = 0
    rate_hz: float = 0.0
    rig_git: str = ""  # commit of the rig, where it lies in a work tree
    cycles: int = 0
    late_cycles: int = 0
    skipped_cycles: int = 0
    held_cycles: int = 0
    metrics: dict[str, float]
    timing_us: dict[str, dict[str, float]] = {}  # stage -> percentile -> us
    timing_level: str = ""
    timing_share: float = 0.0
    latest_cycles: list[dict[str, Any]] = []  # see `latest.latest_cycles`
    frames: Counts = {}  # of all nodes, see `outcome.HEALTH`
    frames_too_many: list[str] = []
    lost: list[str] = []  # input that nothing took on purpose, rows of the log
    warned: list[str] = []
    most_cut: str = ""
    frames_to: dict[str, Counts] = {}  # node -> account
    records: dict[str, int | bool] = {}
    faults: list[str] = []
    injected: list[str] = []
    changed: list[str] = []
    judged: list[str] = []
    not_judged: dict[str, str] = {}  # name -> reason
    expectations_failed: list[str] = []
    requirements: list[Result] = []
    realtime: bool | None = None
    start_to_first_cycle_s: float | None = None
    log_missing: list[str] = []
    verdict: str
    ids: dict[str, str] | msgspec.UnsetType = msgspec.UNSET  # of limits, by their metrics
    device: dict[str, Any] | msgspec.UnsetType = msgspec.UNSET
    bound: dict[str, str] | msgspec.UnsetType = msgspec.UNSET  # see summary_file

    def problems(self) -> list[str]:
        """Return what keeps a run from being ok, a line each."""
        return [
            *self.faults, *self.expectations_failed, *self.lost, *self.frames_too_many,
            *self.log_missing,
        ]  # fmt: skip

    def reasons(self) -> list[str]:
        """Return those problems that the verdict is of, a line each; [] of one that is ok."""
        of = {
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

    def note_failed(self, problems: list[str]) -> None:
        """Enter what was not met besides, if anything was not."""
        self.expectations_failed += problems
        if problems and self.verdict == "ok":
            self.verdict = "expectation not met"

    def note_missing(self, path: Path, error: OSError) -> None:
        """Enter a file of the run that could not be written."""
        self.log_missing.append(f"{path}: cannot be written: {error.strerror or error}")
        if self.verdict in ("ok", "expectation not met"):
            self.verdict = "loss"
        with contextlib.suppress(OSError):  # a part of a file is worse than none
            path.unlink()


def outcome_of(log: logs.Log) -> Outcome:
    """Return what a log alone tells of its run: its faults, and whether it came to its end."""
    facts = log.metadata.get(LEADER, {})
    found = Outcome(facts.get("pacing", ""), facts.get("bus", ""))
    for name, node in log.node.items():
        for event in node.events:
            if event.get("event") == "fault":
                what = event.get("name") or event.get("argument", "")
                found.faults.append(f"{name}: {what}, cycle {event.get('cycle')}")
    leader = log.node.get(LEADER)
    if leader is None or log.metadata.get("run", {}).get("discarded", "0") != "0":
        return found
    done = int(leader.cycle[-1]) + 1 if len(leader.cycle) else 0
    about = leader.description
    if ends_early(log, done - 1, 1e-9 * about.get("period_ns", 0)):
        found.short = f"{done:,} of {about['cycles']:,} cycles: the log ends before"
    return found


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
    found = judge.judge(log, changed, "the run did not finish" if early else "")
    missed = on_purpose.missed_by_the_machine(rig, log, health)
    timing = stage_percentiles(executive, log, outcome, missed[0])
    if timing and rig.config.timing.error is not None:
        found.judged.append("timing")
    worst_us = timing.pop("together", {})
    timing_level, share = level(worst_us, rig.config.rate_hz, rig.config.timing, missed, cycles)
    late = _late_lines(rig, share, missed[0]) if timing_level == "ERROR" else []
    failed = [*found.failed, *_failures(log, outcome, late, judge, found)]
    lost = _lost_lines(log, outcome, each)
    frames_wrong = [*too_many(rig, health), *absence_lines(rig, log), *unlike(log)]
    missing = _missing_lines(executive, log, outcome)
    return Summary(
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
        metrics=found.metrics,
        timing_us=timing,
        timing_level=timing_level,
        timing_share=round(share, 4),
        latest_cycles=outcome.latest,
        frames=health,
        frames_too_many=frames_wrong,
        lost=lost,
        warned=warnings_of(log.node),
        most_cut=most_clipped_signal(rig, log) if health["saturated_values"] else "",
        frames_to=frames_to(rig, log, each),
        records=_records(rig, log, outcome),
        faults=outcome.faults,
        injected=on_purpose.started_faults(log),
        changed=changed,
        judged=found.judged,
        not_judged=found.not_judged,
        expectations_failed=failed,
        requirements=found.requirements,
        realtime=outcome.realtime,
        start_to_first_cycle_s=_start_s(executive, outcome),
        log_missing=missing,
        verdict=_verdict(outcome, failed, [*lost, *frames_wrong, *missing]),
        ids=rig.config.limit_ids() or msgspec.UNSET,
    )


def _late_lines(rig: Rig, share: float, skipped: int) -> list[str]:
    """Return what is wrong with the timing of a run whose level is ERROR."""
    limit = rig.config.timing.error
    line = f"lateness and work at p99.9 are {share:.2f} of a period, limit {limit}"
    return [line + f"; {skipped:,} periods were skipped" * (skipped > 0)]


def _failures(
    log: logs.Log, outcome: Outcome, late: list[str], judge: Judge, found: Judgement
) -> list[str]:
    """Return what was not met beside the rig's limits and requirements."""
    failed = [line for node in log.node.values() for line in mistakes(node)] + late
    if outcome.short and not (outcome.interrupted or outcome.faults):
        failed.append(outcome.short)
    if outcome.strict:
        failed += [f"{judge.named(k)} was not judged: {why}" for k, why in found.not_judged.items()]
        failed += ["nothing was judged"] * (not found.judged and not found.not_judged)
    return failed


def _lost_lines(log: logs.Log, outcome: Outcome, each: Mapping[str, Counts]) -> list[str]:
    """Return what was lost: input that nothing took on purpose, rows of the log."""
    lost = on_purpose.missing_input(log, each)
    lost += [outcome.stall] * bool(lost and outcome.stall)
    dropped = _dropped_rows(log, outcome)
    return lost + [f"{dropped:,} rows found a ring full and are not in the log"] * bool(dropped)


def _missing_lines(executive: logs.Node | None, log: logs.Log, outcome: Outcome) -> list[str]:
    """Return what the log should have and has not."""
    absent = [f"{name}: not in the log" for name in outcome.nodes if name not in log.node]
    replaced = _replacement_lines(executive, log, outcome)
    return [*log.missing, *absent, *replaced, *outcome.missing]


def _verdict(outcome: Outcome, failed: list[str], losses: list[str]) -> str:
    """Return the verdict, the gravest of what happened."""
    if outcome.interrupted:
        return "interrupted"
    if outcome.faults:
        return "safety stop"
    return "loss" if losses else "expectation not met" if failed else "ok"


def _records(rig: Rig, log: logs.Log, outcome: Outcome) -> dict[str, int | bool]:
    """Return how many cycles are in the log, and rows that are not."""
    kept_back = {"kept_back": True} if rig.config.record.keep is not None else {}
    counts = {"written": _recorded_cycles(log, outcome), "dropped": _dropped_rows(log, outcome)}
    return {**counts, **kept_back}


def branch_lines(log: logs.Log) -> list[str]:
    """Return of which log a run is a branch, and where it begins; [] if it is none."""
    about = log.metadata.get(LEADER, {})
    if "branch_of" not in about:
        return []
    parent = Path(about["branch_of"])
    return [f"branch at cycle {about.get('branch_cycle')} of {parent.parent.name}/{parent.name}"]


def is_branch(summary: Summary) -> bool:
    """Return whether a summary is that of a branch."""
    return any(one.startswith("branch at cycle ") for one in summary.changed)


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


def _start_s(executive: logs.Node | None, outcome: Outcome) -> float | None:
    """Return the time from the command to the executive's first cycle."""
    if executive is None or outcome.begin_ns is None:
        return None
    first_ns = int(executive.stamp_ns[0])
    if outcome.pacing == "lockstep":  # its stamps are k T
        ahead_ns = time.time_ns() - time.monotonic_ns()
        first_ns = round(1e9 * float(executive.timing["timing.wall_s"][0])) - ahead_ns
    return round(1e-9 * (first_ns - outcome.begin_ns), 2)


def _replacement_lines(executive: logs.Node | None, log: logs.Log, outcome: Outcome) -> list[str]:
    """Return a line if the log was replaced: by one from before the command, or paced otherwise."""
    if executive is None or outcome.begin_ns is None:
        return []
    paced = log.metadata.get(LEADER, {}).get("pacing", outcome.pacing)
    before = outcome.pacing not in WITHOUT_CLOCK and executive.stamp_ns[0] < outcome.begin_ns
    other = bool(paced != outcome.pacing or before)
    return ["the log is that of another run: it was replaced while this one went on"] * other


def _each_health(log: logs.Log, outcome: Outcome) -> dict[str, dict[str, int]]:
    """Return the counters of each node: its own ones if it ran here, else the last in the log."""
    found = dict(outcome.health)
    for role, node in log.node.items():
        if role not in found:
            wanted = [f"health.{name}" for _, name in HEALTH.values()]
            wanted += [name for name in node.columns if name.startswith(COUNT)]
            found[role] = counters(
                {
                    name: own[name][-1]
                    for own in (node.timing, node.columns)
                    for name in wanted
                    if name in own and len(own[name])
                }
            )
    return found


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


def _dropped_rows(log: logs.Log, outcome: Outcome) -> int:
    """Return the rows that found a ring full: as the recorder counted, if it came to its end."""
    counts = {k: int(v) for k, v in log.metadata.get("run", {}).items() if k.startswith("dropped.")}
    return max(sum(counts.values()), outcome.dropped)


def _recorded_cycles(log: logs.Log, outcome: Outcome) -> int:
    """Return the cycles in the log: as the recorder counted, if it came to its end."""
    run = log.metadata.get("run", {})
    counts = [int(n) for k, n in run.items() if re.fullmatch(r"written\..*\.record", k)]
    if counts and run.get("discarded", "0") == "0":
        return sum(counts)
    kept = outcome.kept or {name: len(node.cycle) for name, node in log.node.items()}
    return sum(kept.values())
