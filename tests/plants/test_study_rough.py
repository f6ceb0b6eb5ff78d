"""The study of the rougher world: what is paired, what is drawn, what its tables say."""

from pathlib import Path

import numpy as np
import pytest

from pcpc.executive.rig.reading import load_rig
from pcpc.plants.atb1000.book import study_rough as study
from pcpc.plants.study import Case, CaseResult
from pcpc.tools.study.experiment import runs as runs

CASES = list(study.cases())
COST = {"gyros": 1.25, study.ALL: 3.0}  # of each law, made up


def of(case: Case) -> CaseResult:
    """Return a result as if errors were the barrel's number, worse by law and part."""
    law, i = study.LAWS.index(case.controller), int(case.label)
    rms = (1.0 + law) * (1.0 + i) * COST.get(case.group, 1.0)
    return CaseResult(case, {study.RMS: rms, study.STEP: 0.1})


RESULTS = [of(case) for case in CASES]


def test_runs_of_a_barrel_differ_in_law_and_switches_alone() -> None:
    switches = ("barrel.rough", "barrel.delay_samples=")
    for label in ("0", "49", "199"):
        own = [case for case in CASES if case.label == label]
        kinds = 2 + (len(study.PARTS) if int(label) < study.IN_PARTS else 0)
        assert len(own) == kinds * len(study.LAWS)
        plain = {tuple(s for s in c.settings if not s.startswith(switches)) for c in own}
        assert len(plain) == 1 and len({(c.controller, c.settings) for c in own}) == len(own)
    drawn = {case.settings[-1] for case in CASES}
    assert len(drawn) == study.BARRELS == 200, "each barrel has a world of its own"


def test_every_rig_can_be_run_and_every_kind_goes_in_lanes() -> None:
    some = [c for c in CASES if c.controller == "pd" and c.label in ("0", "1", "2")]
    for case in some:
        load_rig(case.rig, case.controller, case.settings)
    sizes = {
        case.group: len(piece.own)
        for piece in runs.pieces(some, least=1)
        for case in (piece.own[0].case,)
    }
    assert sizes == dict.fromkeys((study.NONE, study.ALL, *study.PARTS), 3)


def test_a_switch_of_the_study_does_what_its_name_says() -> None:
    for kind in (study.NONE, study.ALL, *study.PARTS):
        case = next(c for c in CASES if c.group == kind)
        rig = load_rig(case.rig, case.controller, case.settings)
        (barrel,) = rig.nodes()["plant"].blocks
        on = {n for n, v in barrel.settings.items() if n.startswith("rough") and v == 1.0}
        on |= {"late"} if barrel.settings["delay_samples"] > 0.0 else set()
        wanted = {study.NONE: set(), study.ALL: {"rough"}}
        wanted |= {k: {"late" if "late" in k else f"rough_{k}"} for k in study.PARTS}
        assert on == wanted[kind], f"{kind}: {on}"


def test_costs_are_of_the_same_barrel_and_intervals_hold_the_median() -> None:
    assert study.costs(RESULTS, "lqg", study.ALL) == pytest.approx([3.0] * 200)
    assert study.costs(RESULTS, "pd", "gyros") == pytest.approx([1.25] * 50)
    shuffled = [RESULTS[i] for i in np.random.default_rng(2).permutation(len(RESULTS))]
    assert study.report(shuffled) == study.report(RESULTS)
    assert study.best(RESULTS, study.NONE) == {law: 200 * (law == "pd") for law in study.LAWS}
    middle, low, high = study.interval(np.random.default_rng(5).normal(2.0, 1.0, 200))
    wide = 1.2533 * 1.96 / np.sqrt(200)  # of the median of normal values
    assert low < middle < high and 0.7 * 2 * wide < high - low < 1.4 * 2 * wide


def test_a_run_that_ended_early_counts_as_lost(tmp_path: Path) -> None:
    lost = [
        CaseResult(r.case, diverged=True)
        if r.case.controller == "lqg" and r.case.group == study.ALL and r.case.label == "7"
        else r
        for r in RESULTS
    ]
    assert np.isinf(study.costs(lost, "lqg", study.ALL)).tolist() == [i == 7 for i in range(200)]
    (row,) = [line for line in study.report(lost).splitlines() if line.startswith("| lqg")]
    assert row.split(" | ")[3:6] == ["3.000 (3.000 to 3.000)", "3.00", "inf"], row
    assert row.endswith("| 0.1 | 1 |"), row
    study.draw(lost, tmp_path)
    assert (tmp_path / "rough.png").stat().st_size > 10_000
