"""Runs of studies: done in lanes they are what each is by itself, to the last bit."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from pcpc import plants
from pcpc.plants.study import Case, CaseResult
from pcpc.tools.study.experiment import runs as runs

RIGS = Path(plants.__file__).parent / "atb1000" / "rigs"
HULL = str(RIGS / "hull.yaml")
SHORT = "duration_s=0.3"
TRACES = ("plant:barrel.theta_rad", "executive:controller.e_rad", "theta_rad", "no.such")


def case(
    *settings: str,
    controller: str = "pd_nn",
    rig: str = HULL,
    traces: tuple[str, ...] = TRACES,
) -> Case:
    return Case("g", rig, controller, "a label", (SHORT, *settings), (0.1, 0.2), traces)


def in_process(cases: Sequence[Case]) -> tuple[list[CaseResult], list[int]]:
    """Return what `done` returns, and the sizes of the pieces."""
    pieces = runs.pieces(cases, least=1)
    made = {
        place: one
        for piece in pieces
        for place, one in zip(piece.places, runs.results(piece), strict=True)
    }
    assert sorted(made) == list(range(len(cases))), "every case is done once"
    return [made[place] for place in range(len(cases))], [len(piece.own) for piece in pieces]


def bits(result: CaseResult) -> dict[str, object]:
    about: dict[str, object] = {
        name: np.asarray(value).tobytes()
        for part in (result.metrics, result.traces, result.settings)
        for name, value in part.items()
    }
    return about | {"case": result.case, "early": result.diverged, "failed": result.failed}


def test_alike_runs_are_done_in_lanes_with_the_bits_of_each_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cases = [
        case(), case("seed=3"), case("barrel.gap_rad=0.002", "seed=4"), case(controller="pd"),
        case("controller.kv_Nms_rad=120.0"), case("rate_hz=500"), case("seed=5"),
    ]  # fmt: skip
    expected = [runs.alone(one) for one in cases]
    lonely: list[Case] = []
    single = runs.alone
    monkeypatch.setattr(runs, "alone", lambda one: lonely.append(one) or single(one))
    found, sizes = in_process(cases)
    assert sizes == [5, 1, 1], "what differs in more than seed and numbers of blocks is alone"
    assert lonely == [cases[3], cases[5]], "the others are done in lanes"
    assert [bits(one) for one in found] == [bits(one) for one in expected]
    assert len({one.traces["theta_rad"].tobytes() for one in found}) == len(found), "all differ"


def test_a_case_that_says_what_the_rig_says_is_alike() -> None:
    cases = [case(), case("rate_hz=1000.0"), case("rate_hz=500", "rate_hz=1000"), case("seed=2")]
    found, sizes = in_process(cases)
    assert sizes == [3, 1], "the last of two values rules, so that both are kept"
    assert [bits(one) for one in found] == [bits(runs.alone(one)) for one in cases]
    assert bits(found[0]) | {"case": None} == bits(found[1]) | {"case": None}


def test_few_runs_are_not_worth_lanes() -> None:
    cases = [case(f"seed={seed}") for seed in range(6)]
    assert [len(piece.own) for piece in runs.pieces(cases)] == [1] * 6
    assert [len(piece.own) for piece in runs.pieces(cases, least=7)] == [1] * 6
    assert [len(piece.own) for piece in runs.pieces(cases, least=6)] == [6]


def test_whole_numbers_are_switches_but_for_seeds() -> None:
    switched = [case(f"barrel.friction_model={i % 2}", f"seed={i}") for i in range(8)]
    assert [len(piece.own) for piece in runs.pieces(switched, least=1)] == [4, 4]
    rig = str(RIGS.parents[1] / "friction_arm" / "rigs" / "friction-a.yaml")
    seeded = [case(f"controller.network_seed={i}", rig=rig) for i in range(8)]
    assert [len(piece.own) for piece in runs.pieces(seeded, least=1)] == [8]


def test_alike_runs_may_differ_in_traces_and_in_switches_that_part_them() -> None:
    some = [(), TRACES[:1], TRACES[2:]]
    cases = [
        case(f"barrel.friction_model={i % 3 != 0:.1f}", f"seed={i}", traces=some[i % 3])
        for i in range(6)
    ]
    found, sizes = in_process(cases)
    assert sizes == [6]
    assert [bits(one) for one in found] == [bits(runs.alone(one)) for one in cases]
    assert [len(one.traces) for one in found] == [0, 2, 3] * 2, "each its own, and the time"


def test_what_lanes_refuse_says_what_it_says_alone() -> None:
    wrong = ("barrel.gap_rad=-1.0", "barrel.gap=0.1", "evaluation.window_s=[0.2, 0.1]")
    cases = [case(), *(case(one) for one in wrong), case("seed=3"), case("seed=4")]
    found, sizes = in_process(cases)
    assert [bits(one) for one in found] == [bits(runs.alone(one)) for one in cases]
    assert [bool(one.failed) for one in found] == [False, True, True, True, False, False]
    assert max(sizes) > 1


def test_a_rig_that_is_wrong_says_so_for_each_case(tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(f"base: {os.path.relpath(HULL, tmp_path)}\nrig: wrong\nrate_hz: fast\n")
    found, _ = in_process([case(f"seed={seed}", rig=str(path)) for seed in range(3)])
    assert all("rate_hz" in one.failed for one in found), [one.failed for one in found]
