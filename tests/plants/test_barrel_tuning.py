"""The committed tuning of the barrel: its rule gives the rig's gains, its numbers come again."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from pcpc.executive.rig.reading import load_rig
from pcpc.plants.atb1000.book import tuning
from pcpc.plants.atb1000.book.tuning import RANGES, TABLE, Candidate
from pcpc.tools.study.experiment.runs import alone
from pcpc.tools.study.margin.book import tuning as command

FOUND = tuning.read()


def row(law: str, number: int) -> Candidate:
    return next(one for one in FOUND if (one.law, one.number) == (law, number))


def gains_of(controller: str) -> dict[str, float]:
    nodes = load_rig(tuning.RIGS / "hull.yaml", controller).nodes()
    return dict(next(b for b in nodes["executive"].blocks if b.name == "controller").settings)


def test_the_table_holds_the_candidates_of_the_rule() -> None:
    for law in RANGES:
        assert [dict(one.gains) for one in FOUND if one.law == law] == tuning.candidates(law), law


def test_what_is_marked_in_the_table_is_the_choice() -> None:
    assert [one.chosen for one in tuning.marked_rows(FOUND)] == [one.chosen for one in FOUND]
    assert sorted(one.law for one in FOUND if one.chosen) == sorted(RANGES), "one of each law"
    for law in RANGES:
        best = tuning.choice(FOUND, law)
        assert best is not None and best.allowed, law
        better = [one for one in FOUND if one.law == law and one.score < best.score]
        assert not any(one.allowed for one in better), (law, best)


@pytest.mark.parametrize("wrong", [{"step_Nm": 0.26}, {"margin": 0.74}, {"score": math.inf}])
def test_a_candidate_that_breaks_a_limit_is_not_chosen(wrong: dict[str, float]) -> None:
    best = tuning.choice(FOUND, "pd")
    assert best is not None
    others = [replace(one, **wrong) if one is best else one for one in FOUND]
    assert tuning.choice(others, "pd") not in (None, best)


@pytest.mark.parametrize("law", RANGES)
def test_the_rigs_gains_are_the_choice(law: str) -> None:
    best = tuning.choice(FOUND, law)
    assert best is not None
    name = law if best.number == 0 and law == "nn_backstepping" else tuning.controller(law)
    rig = gains_of(name)
    assert {gain: rig[gain] for gain in best.gains} == dict(best.gains)


@pytest.mark.parametrize("law", [law for law in RANGES if law not in tuning.RIVALS])
def test_the_gains_by_hand_are_those_that_the_rig_still_has(law: str) -> None:
    rig = gains_of(law)
    assert {gain: rig[gain] for gain in RANGES[law]} == tuning.candidates(law)[0]


def test_a_run_of_the_table_comes_again() -> None:
    best = tuning.choice(FOUND, "pd_adaptive")
    assert best is not None
    i = tuning.SCENARIOS.index("slew10")
    own = [
        case
        for case in tuning.cases(["pd_adaptive"])
        if case.label == str(best.number) and Path(case.rig).stem == "slew10"
    ]
    mean = sum(alone(case).metric(tuning.RMS) for case in own) / len(own)
    assert len(own) == len(tuning.SEEDS) and f"{mean:.4g}" == f"{best.rms[i]:.4g}", (mean, best)


def test_the_margin_of_the_table_comes_again() -> None:
    found = command.margin_of(("lqg", 0))
    assert abs(found - row("lqg", 0).margin) < 1e-3, found


def test_a_table_is_read_as_it_was_written(tmp_path: Path) -> None:
    tuning.write(FOUND, tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == TABLE.read_bytes()
    assert tuning.read(tmp_path / "again.csv") == FOUND


def test_scores_are_relative_to_pd_by_hand() -> None:
    assert row("pd", 0).score == 1.0
    one = row("pid", 0)
    told = math.prod(a / b for a, b in zip(one.rms, row("pd", 0).rms, strict=True)) ** 0.25
    assert abs(told - one.score) < 1e-3 * one.score, (told, one.score)
