"""Findings: which key and verdict each kind costs, and which word counts of a log and a summary."""

import dataclasses
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from processes import RIGS

from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.timing_layout import Stage
from pcpc.executive.nodes.virtual import VirtualRun, in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict.findings import JUDGED, Finding, FindingKind, lines
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.after.verdict.requirements import JudgedRequirement
from pcpc.tools.after.verdict.summary import Summary, summarise
from pcpc.tools.after.verdict.summary_file import findings_beside, findings_of, from_json, plain

COSTS = {  # kind -> key of summary.json, verdict
    **dict.fromkeys(FindingKind, ("expectations_failed", "expectation not met")),
    FindingKind.INPUT: ("lost", "loss"), FindingKind.FRAMES: ("frames_too_many", "loss"),
    FindingKind.LOG: ("log_missing", "loss"), FindingKind.FAULT: ("faults", "safety stop"),
    FindingKind.STOP: ("", "interrupted"),
}  # fmt: skip
LISTS = "expectations_failed", "lost", "frames_too_many", "log_missing", "faults"
LIMIT = Finding(FindingKind.LIMIT, "", True, "m", "R-1", 0.5, 0.0, 1.0, margin=0.5)
BROKEN = Finding(FindingKind.LIMIT, "= 2, expected 0 to 1", False, "m", "", 2.0, 0.0, 1.0)


@pytest.mark.parametrize("kind", FindingKind)
def test_what_does_not_hold_is_in_one_key_and_costs_its_verdict(kind: FindingKind) -> None:
    found = Summary(metrics={}, verdict="ok")
    found.enter(Finding(kind, "why", name="m"))
    key, verdict = COSTS[kind]
    words = "m: why" if kind is FindingKind.REQUIREMENT else "m why"
    told = {name: getattr(found, name) for name in LISTS if getattr(found, name)}
    assert (told, found.verdict) == ({key: [words]} if key else {}, verdict)
    assert found.judged == ["m"] * (kind in JUDGED)
    assert -found.findings[0].low == found.findings[0].high == math.inf


@pytest.mark.parametrize("kind", JUDGED)
def test_what_holds_or_was_not_judged_costs_nothing_of_its_own(kind: FindingKind) -> None:
    for held, verdict in ((True, "ok"), (None, "not judged")):
        found = Summary(metrics={}, verdict="ok")
        found.enter(Finding(kind, "why", held, "m"))
        assert not any(getattr(found, name) for name in LISTS) and found.verdict == verdict
        assert (found.judged, found.not_judged) == (["m"], {}) or held is None
        assert found.not_judged == ({"m": "why"} if held is None else {})


@pytest.mark.parametrize("kind", [one for one in FindingKind if one is not FindingKind.STOP])
def test_a_summary_that_was_read_is_no_better_than_its_own_lines(kind: FindingKind) -> None:
    key, verdict = COSTS[kind]
    for word in ("ok", "not judged", "fine", verdict, "interrupted"):
        read = from_json({"metrics": {}, "verdict": word, key: ["why"]})
        assert read.verdict == ("interrupted" if word == "interrupted" else verdict)
    told = {"name": "m", "held": False}
    assert from_json({"metrics": {}, "verdict": "ok", "requirements": [told]}).verdict != "ok"
    assert from_json({"metrics": {}, "verdict": "fine"}).verdict == "fine"


def test_the_limit_of_timing_needs_no_name() -> None:
    found = Summary(metrics={}, verdict="ok")
    found.enter(Finding(FindingKind.TIMING, "", True), Finding(FindingKind.TIMING, "late"))
    assert (found.judged, found.expectations_failed) == (["timing"] * 2, ["late"])


@pytest.mark.parametrize("order", [1, -1])
def test_the_gravest_counts_in_any_order(order: int) -> None:
    found, words = Summary(metrics={}, verdict="ok"), []
    for kind in (FindingKind.LIMIT, FindingKind.LOG, FindingKind.FAULT, FindingKind.STOP)[::order]:
        found.enter(*lines(kind, ["x"]))
        words.append(found.verdict)
    climb = ["expectation not met", "loss", "safety stop", "interrupted"]
    assert words == (climb if order > 0 else ["interrupted"] * 4)


@pytest.mark.parametrize(
    ("own", "found", "held", "why"),
    [
        ({}, LIMIT, True, ""),
        ({"metrics": {"m": 1.0}}, LIMIT, True, ""),
        ({"metrics": {"m": 1.5}}, LIMIT, False, "summary.json says so"),
        ({"metrics": {"m": -0.1}}, LIMIT, False, "summary.json says so"),
        ({"not_judged": {"m": "too short"}}, LIMIT, None, "too short"),
        ({"not_judged": {"R-1 m": "too short"}}, LIMIT, True, ""),
        ({"requirements": [JudgedRequirement("m", False)]}, LIMIT, True, ""),
        ({"not_judged": {"m": "short"}}, BROKEN, None, "short"),
        ({"requirements": [JudgedRequirement("m", False)]},
         JudgedRequirement("m", True).finding, False,
         "summary.json says so"),
        ({"requirements": [JudgedRequirement("m", False)]},
         JudgedRequirement("m", None, "gone").finding, None, "gone"),
        ({"not_judged": {"m": "short"}}, JudgedRequirement("m", True).finding, None, "short"),
        ({"not_judged": {"m": "short"}},
         JudgedRequirement("m", False).finding, False, "violated first"),
        ({"metrics": {"m": 9.0}}, JudgedRequirement("m", True).finding, True, "met, margin"),
    ],
)  # fmt: skip
def test_the_worse_of_what_log_and_summary_say_counts(
    own: dict[str, Any], found: Finding, held: bool | None, why: str
) -> None:
    summary = Summary(**{"metrics": {}, "verdict": "ok", **own})
    (one,) = findings_beside(summary, [found, *lines(FindingKind.LOG, ["cut"])])
    assert one.held is held and one.why.startswith(why), one


@pytest.mark.parametrize("held", [True, False, None])
def test_an_id_stands_before_the_name_in_words_and_not_in_the_name(held: bool | None) -> None:
    one = JudgedRequirement("R-1 stays R-1 near", held, "gone", id="R-1").finding
    assert (one.id, one.name, one.key) == ("R-1", "stays R-1 near", "R-1 stays R-1 near")
    assert str(one).startswith("R-1 stays R-1 near")
    assert one.why.startswith({True: "met", False: "violated", None: "gone"}[held])
    limit = Finding(FindingKind.LIMIT, "= 2", False, "m", "R-2")
    assert (limit.key, str(limit)) == ("m", "R-2 m = 2")


@pytest.mark.parametrize(
    ("limit", "changed", "held"),
    [
        ([0.0, 1e9], [], [True]), ([-2.0, -1.0], [], [False]),
        ([0.0, 1e9], ["evaluation.x"], [None]),
        ([-2.0, -1.0], ["evaluation.x"], [None]),
    ],
)  # fmt: skip
def test_a_summary_that_was_read_tells_what_the_run_did(
    limit: list[float], changed: list[str], held: list[bool | None]
) -> None:
    """And a second limit that fails makes the log the judge of the first."""
    window = "evaluation.window_s=[0.0, 0.2]"
    rig = load_rig(RIGS / "slew10.yaml", settings=["duration_s=0.2", window])
    log, name = in_memory(rig), "hub_error_max_mrad"
    for more in ({}, {"muzzle_error_rms_mrad": [-2.0, -1.0]}):
        one = rig.changed(expect={rig.config.controller: {name: limit, **more}})
        judge = Judge.of(one)
        now = summarise(one, log, Outcome("virtual", "memory", changed=list(changed)), judge)
        read = from_json(plain(now))
        assert read == now and read.findings == []
        ours, theirs = findings_of(now, judge, log), findings_of(read, judge, log)
        assert [found.held for found in theirs][:1] == held
        both = ([(found.held, found.why) for found in several] for several in (ours, theirs))
        assert next(both) == next(both)
    read.judged = []
    read.expectations_failed = []
    assert [found.held for found in findings_of(read, judge, log)] == [None, None]


def test_what_an_end_a_branch_and_timing_alone_come_to() -> None:
    rig = load_rig(RIGS.parents[1] / "probe" / "rig.yaml", settings=["duration_s=0.1"])
    log, short = in_memory(rig), "5 of 9 cycles"
    asked = summarise(rig, log, Outcome("virtual", "", interrupted=True, short=short))
    assert (asked.verdict, asked.expectations_failed) == ("interrupted", [])
    ended = summarise(rig, log, Outcome("virtual", "", short=short, strict=True))
    assert ended.expectations_failed == [short, "nothing was judged"] and not ended.judged
    facts = {**log.metadata["executive"], "branch_of": "a/log.mcap", "branch_cycle": "5"}
    branch = dataclasses.replace(log, metadata={**log.metadata, "executive": facts})
    outcomes = [summarise(rig, one, Outcome("virtual", "")) for one in (log, branch)]
    assert [one.is_branch for one in outcomes] == [False, True]
    times = {f"timing.{stage}_us": np.full(100, 900.0) for stage in Stage.words()}
    node = dataclasses.replace(log.node["executive"], timing=times)
    slow = dataclasses.replace(log, node={"executive": node})
    for error, failed in ((0.5, True), (1e9, False), (None, None)):
        limits = msgspec.structs.replace(rig.config.timing, error=error)
        own = rig.changed(timing=limits)
        found = summarise(own, slow, Outcome("real", "", strict=True))
        assert found.judged == ["timing"] * (error is not None)
        assert bool(found.expectations_failed) == (failed is not False), found
        assert ("nothing was judged" in found.expectations_failed) == (error is None)


@pytest.mark.parametrize(("culprit", "why"), [(2, ", outside of its bounds"), (0x121, "")])
def test_the_reason_of_a_value_is_left_out_where_a_later_fault_has_its_word(
    culprit: int, why: str
) -> None:
    block = VirtualRun(load_rig(str(RIGS.parents[1] / "probe" / "rig.yaml")), None).blocks[0]
    control, outcome = block.control, Outcome("virtual", "memory")
    control.fault, control.odd_place, control.culprit = Fault.NOT_PLAUSIBLE, 1, culprit
    outcome.judge("executive", 0, block)
    name = block.description["variables"][0][0]
    assert outcome.faults == [f"executive: {name} was 0 in cycle 0{why}"]
