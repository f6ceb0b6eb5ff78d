"""Searches of a campaign: the same rows and words after a break, judged by margin or metric."""

import dataclasses
import itertools
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from places import ROOT

import pcpc
from pcpc.executive.errors import RigError
from pcpc.tools.cli import main
from pcpc.tools.study.engine import Engine, RunVerdict
from pcpc.tools.study.sweep import shards, store
from pcpc.tools.study.sweep.campaign import Campaign, Shard
from pcpc.tools.study.sweep.results import FAULT, RAN, REFUSED
from pcpc.tools.study.sweep.search import Search
from pcpc.tools.study.sweep.work import Work
from pcpc.tools.terminal.progress import Progress

FAR = "require=[{name: far, always: controller.e_rad < 9, after: 9s}]"
RIG = str(ROOT / "tools/make/template/rig.yaml")
SHORT = ("duration_s=0.6", "evaluation.window_s=[0.1, 0.6]", "evaluation.rest_from_s=0.4")
VARY = ("motor.coulomb_Nm=x0.5:2", "motor.inertia_kg_m2=normal(19e-6,1e-6)")
WORST = Campaign(RIG, ("pid",), VARY, 70, "worst", 3, SHORT)
RARE = dataclasses.replace(WORST, draws=40, sampling="rare")
OVERSHOOT = "overshoot_mrad"


def done(search: Search, folder: Path, threads: int) -> str:
    work = Work(search.campaign, Shard(), folder, None, threads, None, search)
    try:
        return work.to_end(Progress(quiet=True))
    finally:
        work.store.close()


class Killed(Exception):
    """Ends a search in its middle."""


def broken_off(search: Search, folder: Path, rows: int) -> None:
    """Leave a folder as a search that is killed after this many rows leaves it."""
    work = Work(search.campaign, Shard(), folder, None, 1, None, search)

    def shown() -> None:
        if len(work.store) >= rows:
            raise Killed

    engine = Engine(Path(RIG), search.campaign.controllers, SHORT, 1)
    with pytest.raises(Killed):
        search.outcome(engine.rows, work.store, shown)
    work.store.close()


@pytest.mark.parametrize(
    "search",
    [Search(WORST), Search(WORST, OVERSHOOT), Search(RARE, OVERSHOOT, 9.0)],
    ids=["worst margin", "worst metric", "rare"],
)
def test_a_search_that_was_broken_off_comes_to_the_same_rows(
    search: Search, tmp_path: Path
) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    told = done(search, whole, 1)
    broken_off(search, parts, 24)
    assert not (parts / store.EXPORT).exists()
    again = done(search, parts, 3)
    assert told.replace(str(whole), "") == again.replace(str(parts), "") != ""
    rows, others = (shards.merge([folder])[0].to_pylist() for folder in (whole, parts))
    assert repr(rows) == repr(others) and len(rows) >= 40
    assert len({row["seed"] for row in rows}) == 1, "the margin is no function of what varies"
    (whole / "outcome.txt").write_text("pid: p_fail = 0")
    assert done(search, whole, 1) == told, "what came out is told again, whatever stands there"


def test_a_search_among_runs_that_nothing_judges_has_no_worst() -> None:
    none = SimpleNamespace(controller="pid", margins=lambda points: np.full(len(points), np.inf))
    with pytest.raises(RigError, match="--worst: pid: no run could be judged"):
        Search(WORST)._worst(none)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--worst", "20", "--of", "overshot"], "--of overshot: pid has no metric overshot; did"),
        (["--worst", "20", "--set", FAR], "--worst: pid: no run could be judged"),
        (["--rare", "20", "--set", FAR], "a run that is not judged is no good one"),
        (["--until", "p_fail < 0.5 at 95%", "--set", FAR], "no run of pid could be judged"),
        (["--until", "p_fail(far) < 0.5 at 95%", "--set", FAR], "no run of pid could be judged"),
        (
            ["--draws", "4", "--vary", "motor.inertia_kg_m2=normal(-1,0.1)"],
            "all runs were refused: ",
        ),
    ],
)
@pytest.mark.parametrize("there", [False, True])
def test_a_refused_campaign_keeps_what_was_there_and_nothing_else(
    words: list[str], said: str, there: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "a/b"
    if there:
        folder.mkdir(parents=True)
        (folder / "notes.txt").touch()
    settings = [word for setting in SHORT for word in ("--set", setting)]
    command = ["sweep", RIG, *settings, "--vary", "motor.coulomb_Nm=x0.5:2", *words, "--quiet"]
    before = sorted(tmp_path.rglob("*"))
    assert main([*map(str, command), *(["-o", "a/b"] if there else [])]) == 2
    assert said in capsys.readouterr().err and sorted(tmp_path.rglob("*")) == before


def test_rows_that_were_there_before_a_refusal_stay(tmp_path: Path) -> None:
    for had, kept in ((1, 2), (0, 0)):
        folder, row = tmp_path / str(had), RunVerdict(0, "pid", 1, {}, RAN, True)
        for draws in [[0]] * had + [[had]]:
            own = store.Store(folder, WORST.spec(), Shard())
            own.add(dataclasses.replace(row, draw=draw) for draw in draws)
            if draws == [had]:
                own.take_back()
            own.close()
        assert len(store.Store(folder, WORST.spec(), Shard())) == kept


def test_the_worst_is_the_worst_row_and_is_run_again_by_its_number(tmp_path: Path) -> None:
    lines = done(Search(WORST, OVERSHOOT), tmp_path, 2).splitlines()
    rows = shards.merge([tmp_path])[0].to_pylist()
    worst = max(rows, key=lambda row: row[f"metric:{OVERSHOOT}"])
    assert len(rows) == 70 and lines[0] == "pid: the worst of 70 runs"
    assert lines[1].startswith(f"  draw {worst['draw']}: {worst[f'metric:{OVERSHOOT}']:.4g}: ")
    assert lines[-1].endswith(f"pcpc sweep rerun {tmp_path} DRAW CONTROLLER")
    metrics = [row[f"metric:{OVERSHOOT}"] for row in rows]
    assert max(metrics[:16]) < max(metrics), "it came no further than its first draws"


def test_a_likely_failure_is_the_share_of_the_rows(tmp_path: Path) -> None:
    told = done(Search(RARE, OVERSHOOT, 0.0), tmp_path / "likely", 2)
    rows = shards.merge([tmp_path / "likely"])[0].to_pylist()
    failed = [row[f"metric:{OVERSHOOT}"] > 0.0 for row in rows]
    assert len(rows) == 40 and sum(failed) > 0
    assert f"p_fail = {sum(failed) / 40:.2g}, between" in told and "by 40 runs" in told
    first = f"  draw {failed.index(True)}: "
    assert told.splitlines()[1].startswith(first)


def test_the_margin_of_a_row() -> None:
    def row(outcome: str, **more: object) -> RunVerdict:
        return RunVerdict(0, "pid", 1, {}, outcome, **({"ok": True} | more))  # type: ignore[arg-type]

    by_requirement, by_metric = Search(WORST), Search(RARE, "m", 3.0)
    assert by_requirement.margin(row(RAN, margins={"a": 0.5, "b": -0.25, "c": None})) == -0.25
    assert by_requirement.margin(row(RAN, margins={"c": None})) == math.inf
    assert by_requirement.margin(row(RAN, ok=False)) == -math.inf, "it could not be judged"
    bare: dict[str, Any] = {"margins": {"a": 0.5}, "metrics": {"m": 0.0}, "held": {"a": True}}
    assert by_requirement.margin(row(RAN, ok=False, **bare)) == 0.5, "a limit is no requirement"
    assert by_requirement.margin(row(RAN, **bare | {"held": {"b": False}})) == -math.inf
    assert by_requirement.margin(row(RAN, ok=False, **bare | {"metrics": {}})) == -math.inf
    assert by_requirement.margin(row(RAN, ok=False, **bare | {"margins": {}})) == -math.inf
    assert by_requirement.margin(row(RAN, margins={"a": math.nan, "b": 2.0})) == 2.0
    assert by_metric.margin(row(RAN, metrics={"m": -math.inf})) == -math.inf
    assert by_metric.margin(row(RAN, metrics={"m": 5.0})) == -2.0
    assert by_metric.margin(row(RAN, metrics={"m": math.nan})) == -math.inf
    for search, (outcome, margin) in itertools.product(
        (by_requirement, by_metric), ((FAULT, -math.inf), (REFUSED, math.inf))
    ):
        told = row(outcome, margins={"a": 1.0}, metrics={"m": 0.0})
        assert search.margin(told) == margin


HELD: dict[str, Any] = {"margins": {"a": 1.0, "b": 2.0}, "held": {"a": True, "b": True}}
PARTLY: dict[str, Any] = {"margins": {"a": 1.0, "b": None}, "held": {"a": True, "b": None}}
UNKNOWN: dict[str, Any] = {"margins": {"a": None}, "held": {"a": None}, "ok": None}
FAILED: dict[str, Any] = {"margins": {"a": -1.0, "b": None}, "held": {"a": False, "b": None}}


@pytest.mark.parametrize(
    ("about", "of", "unjudged"),
    [
        (HELD, None, False),
        (HELD | {"ok": None}, None, False),
        (PARTLY, None, True),
        (PARTLY | {"ok": None, "why": "b was not judged"}, None, True),
        (UNKNOWN, None, True),
        ({"ok": None}, None, True),
        (FAILED | {"ok": False}, None, False),
        ({"ok": False}, None, False),
        (UNKNOWN | {"outcome": FAULT}, None, False),
        (UNKNOWN | {"metrics": {"m": 1.0}}, "m", False),
    ],
)
def test_a_run_that_was_not_judged_is_no_run_without_failure(
    about: dict[str, Any], of: str | None, unjudged: bool, tmp_path: Path
) -> None:
    """With it there is no probability; the worst case of the others says how many there are."""

    def rows_of(asked: Any) -> Any:
        for name, draws in asked:
            yield [
                RunVerdict(
                    **{"draw": one.number, "controller": name, "seed": 1, "values": one.values}
                    | {"outcome": RAN, "ok": True, "metrics": {"m": 1.0}}
                    | (about if one.number == 11 else HELD)
                )
                for one in draws
            ]

    def told(campaign: Campaign, *metric: Any) -> str:
        search = Search(campaign, *metric)
        folder = tmp_path / campaign.sampling
        work = Work(campaign, Shard(), folder, None, 1, None, search)
        try:
            return search.outcome(rows_of, work.store, lambda: None)
        finally:
            work.store.close()

    if unjudged:
        with pytest.raises(RigError, match=r"--rare: draw 11: .*; a run that is not judged is no"):
            told(RARE)
    else:
        assert "pid: no failure in 40 runs" in told(RARE, *((of, 3.0) if of else ())) or (
            "p_fail = 0.025" in told(RARE)
        )
    assert ("70 runs, 1 of which were not judged" in told(WORST, of)) is unjudged


def test_rows_of_other_points_are_no_answer(tmp_path: Path) -> None:
    search = Search(WORST)
    work = Work(WORST, Shard(), tmp_path, None, 1, None, search)
    work.store.add([RunVerdict(0, "pid", 1, {"motor.coulomb_Nm": 1.0}, RAN, True)])
    work.store.close()
    with pytest.raises(RigError, match=r"draw 0 had other values than now.*another -o"):
        done(search, tmp_path, 1)


def from_python(vary: tuple[str, ...], **more: Any) -> pcpc.Sweep:
    short = {name: yaml.safe_load(text) for name, text in (one.split("=", 1) for one in SHORT)}
    return pcpc.sweep(
        RIG, ["pid"], vary=dict(one.split("=", 1) for one in vary), set=short, quiet=True, **more
    )


def test_python_searches_as_the_command_does(tmp_path: Path) -> None:
    for search, asked in (
        (Search(WORST), {"worst": WORST.draws}),
        (Search(RARE, OVERSHOOT, 9.0), {"rare": RARE.draws, "of": OVERSHOOT, "limit": 9.0}),
    ):
        whole = tmp_path / search.campaign.sampling
        told = done(search, whole, 1)
        own = from_python(search.campaign.vary, seed=search.campaign.seed, **asked)
        assert own.statement.replace(str(own.folder), str(whole)) == told
        assert repr(own.table.to_pylist()) == repr(shards.merge([whole])[0].to_pylist())
    for wrong, what in (
        (
            {"worst": 20, "until": "p_fail < 0.1 at 90%"},
            "--until: --worst chooses all its own draws",
        ),
        ({"worst": 20, "rare": 20}, "--worst and --rare: give one of them"),
        ({"limit": 1.0}, "--of and --limit need --worst or --rare"),
    ):
        with pytest.raises(pcpc.Error, match=what):
            from_python(WORST.vary, **wrong)


def test_python_is_told_what_decides_and_what_a_statement_came_to() -> None:
    many = from_python(WORST.vary, draws=64, sampling="random")
    (shares,) = many.sensitivity(f"metric:{OVERSHOOT}").values()
    assert {one.name for one in shares} == {one.partition("=")[0] for one in WORST.vary}
    assert shares[0].first > 0.3, f"{shares[0]}: nothing decides"
    with pytest.raises(pcpc.UnknownName, match=f"did you mean metric:{OVERSHOOT}"):
        many.sensitivity(f"metric:{OVERSHOOT[:-1]}")
    sure = from_python(WORST.vary, until="p_fail(it arrives and stays) < 0.5 at 90%")
    assert sure.statement.startswith("pid: p_fail(it arrives and stays) < 0.5 holds at 90 %: 0 fai")


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ("--worst 20 --of setled_s", "no metric setled_s; did you mean settled_s?"),
        ("--rare 20 --vary motor.resistance_ohm=choice(-1,4)", "draw values that a run can have"),
    ],
)
def test_a_search_that_cannot_be_is_refused_in_one_line(
    words: str, what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    about = ["--vary", VARY[0], "--quiet", *(w for one in SHORT for w in ("--set", one))]
    assert main(["sweep", RIG, *about, *words.split(), "-o", str(tmp_path / "a")]) == 2
    error = capsys.readouterr().err
    assert what in error and error.count("\n") == 1
