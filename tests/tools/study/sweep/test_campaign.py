"""Campaigns: each row is the run that `pcpc simulate` does, whoever did it, when, beside whom."""

import dataclasses
import itertools
import math
import os
import signal
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest
import yaml
from places import ROOT

import pcpc
from pcpc.executive.errors import RigError
from pcpc.tools.api.simulate import simulate
from pcpc.tools.cli import main
from pcpc.tools.study.engine import Bench, Draw, RunVerdict
from pcpc.tools.study.sweep import shards, statements, store
from pcpc.tools.study.sweep.campaign import Campaign, Shard
from pcpc.tools.study.sweep.decision import LOOK
from pcpc.tools.study.sweep.results import FAULT, RAN, REFUSED, Counts, counts
from pcpc.tools.study.sweep.work import Work
from pcpc.tools.terminal import extras
from pcpc.tools.terminal.progress import Progress

RIG = str(ROOT / "tools/make/template/rig.yaml")
SHORT = ("duration_s=0.6", "evaluation.window_s=[0.1, 0.6]", "evaluation.rest_from_s=0.4")
VARY = ("motor.coulomb_Nm=x0.5:2", "motor.inertia_kg_m2=normal(19e-6,1e-6)")
BOTH = Campaign(RIG, ("pid", "pd"), VARY, 21, "random", 5, SHORT)
QUIET, WHOLE = Progress(quiet=True), Shard()


def done(
    campaign: Campaign,
    folder: Path,
    shard: Shard = WHOLE,
    threads: int = 2,
    until: str | None = None,
) -> tuple[dict[tuple[int, str], RunVerdict], str]:
    work = Work(campaign, shard, folder, until, threads)
    try:
        told = work.to_end(QUIET)
        return dict(work.store), told
    finally:
        work.store.close()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    done(BOTH, folder)
    return folder


def rows_of(folder: Path) -> list[dict[str, object]]:
    table, _ = shards.merge([folder])
    return [repr(sorted(row.items())) for row in table.to_pylist()]  # type: ignore[misc]


def draws(campaign: Campaign, first: int, last: int) -> list[tuple[int, Any]]:
    return list(itertools.islice(campaign.numbered(WHOLE), first, last))


def pair(setting: str) -> tuple[str, object]:
    name, _, value = setting.partition("=")
    return name, yaml.safe_load(value)


def test_a_row_is_what_simulate_says_of_its_settings(whole: Path) -> None:
    table, spec = shards.merge([whole])
    rows = table.to_pylist()
    assert [row["draw"] for row in rows] == [i for i in range(21) for _ in range(2)]
    assert {row["alone"] for row in rows} == {""}, "all in lanes"
    for row in (rows[0], rows[1], rows[-1]):
        settings = dict(pair(setting) for setting in spec["settings"])
        varied = {name[5:]: row[name] for name in row if name.startswith("vary:")}
        run = simulate(
            RIG, row["controller"], set={**settings, **varied}, seed=row["seed"], quiet=True
        )
        told = {name[7:]: row[name] for name in row if name.startswith("metric:")}
        assert {k: v for k, v in told.items() if v == v} == run.metrics
        margins = {one.name: one.margin for one in run.requirements}
        assert {name: row[f"margin:{name}"] for name in margins} == margins
    assert rows[0]["margin:it arrives and stays"] == rows[0]["margin:it arrives and stays"], "told"


def test_a_row_is_ok_where_simulate_says_so_and_none_where_nothing_is_judged() -> None:
    vary, both = "motor.inertia_kg_m2", {True: 0, False: 0}
    bench = Bench(Path(RIG), "pid", [])
    for i, row in enumerate(
        bench.rows([Draw(i, 1 + i, {vary: 19e-6 * (1 + i)}) for i in range(5)])
    ):
        run = simulate(RIG, "pid", set={vary: 19e-6 * (1 + i)}, seed=1 + i, quiet=True)
        assert row.ok == (run.verdict == "ok"), (row.why, run.verdict)
        both[bool(row.ok)] += 1
    assert all(both.values()), both
    (row,) = Bench(ROOT / "plants/probe/rig.yaml", "proportional", ["duration_s=0.02"]).rows(
        [Draw(0, 1, {})]
    )
    assert (row.ok, row.why) == (None, "nothing was judged")


def test_a_statement_about_what_nothing_judges_is_refused(tmp_path: Path) -> None:
    probe = Campaign(
        str(ROOT / "plants/probe/rig.yaml"),
        ("proportional",),
        (),
        10_000,
        "random",
        1,
        ("duration_s=0.02",),
    )
    with pytest.raises(RigError, match="no run of proportional could be judged, with draw 0 noth"):
        done(probe, tmp_path, until="p_fail < 0.1 at 90%")


@pytest.mark.parametrize("threads", [1, 3])
def test_shards_in_any_order_by_any_number_of_threads_make_the_same_table(
    whole: Path, tmp_path: Path, threads: int
) -> None:
    for number in (3, 1, 2):
        done(BOTH, tmp_path, Shard(number, 3), threads)
    assert len(list(tmp_path.glob("*.sqlite"))) == 3
    assert rows_of(tmp_path) == rows_of(whole)


def test_what_was_done_is_not_done_again(whole: Path, tmp_path: Path) -> None:
    kept = Work(BOTH, Shard(), tmp_path, None, 1).store
    rows = [row for row in done(BOTH, tmp_path / "other")[0].values() if row.draw < 9]
    kept.add(dataclasses.replace(row, alone="kept") for row in rows)
    half = Bench(Path(RIG), "pid", SHORT).rows([BOTH.draw("pid", *d) for d in draws(BOTH, 9, 12)])
    kept.add(half)
    kept.close()
    again, _ = done(BOTH, tmp_path)
    assert sum(row.alone == "kept" for row in again.values()) == 18 and len(again) == 42
    marked = [one.replace("'kept'", "''") for one in rows_of(tmp_path)]
    assert marked == rows_of(whole), "draws 9 to 11 of pid were done again, beside those of pd"


def test_a_row_that_is_done_again_and_differs_is_told(tmp_path: Path) -> None:
    rows = store.Store(tmp_path, BOTH.spec(), WHOLE)
    row = RunVerdict(3, "pid", 7, {}, RAN, True, metrics={"nan": math.nan})
    rows.add([row])
    rows.add([row, dataclasses.replace(row, draw=4)])
    assert sorted(rows) == [(3, "pid"), (4, "pid")]
    with pytest.raises(RigError, match="draw 4 of pid had another result the second time; begin"):
        rows.add([dataclasses.replace(row, draw=5), dataclasses.replace(row, draw=4, ok=False)])
    assert sorted(rows) == [(3, "pid"), (4, "pid")], "all or none"
    rows.close()


def test_a_killed_campaign_loses_no_row_that_was_written(tmp_path: Path) -> None:
    long = dataclasses.replace(BOTH, draws=400, settings=())
    words = [sys.executable, "-c", "from pcpc.tools.cli import main; main()", "sweep", RIG,
             "--controllers", "pid,pd", "--sampling", "random", "--seed", "5", "--draws", "400",
             "--threads", "1", "--quiet", "-o", str(tmp_path)]  # fmt: skip
    words += [word for one in VARY for word in ("--vary", one)]
    process = subprocess.Popen(words, env=os.environ | {"PCPC_CPU": "generic"})
    log, give_up = tmp_path / "shard-1-of-1.sqlite-wal", time.monotonic() + 240.0
    while time.monotonic() < give_up and process.poll() is None:
        if log.exists() and log.stat().st_size > 60_000:
            break
        os.sched_yield()
    assert process.poll() is None, "it ended before it could be killed"
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = store.Store(tmp_path, long.spec(), WHOLE)
    there = dict(kept)
    kept.close()
    assert 16 <= len(there) < 800 and len(there) % 8 == 0, "whole pieces"
    bench = {name: Bench(Path(RIG), name, []) for name in long.controllers}
    for name, (number, point) in itertools.product(
        bench, itertools.islice(long.numbered(WHOLE), 8)
    ):
        draw = long.draw(name, number, point)
        assert repr(bench[name].rows([draw])) == repr([there[number, name]])


def test_one_process_at_a_time_has_a_shard_and_a_folder_one_campaign(tmp_path: Path) -> None:
    first = store.Store(tmp_path, BOTH.spec(), Shard(1, 2))
    with pytest.raises(RigError, match="another process works on this shard; wait"):
        store.Store(tmp_path, BOTH.spec(), Shard(1, 2))
    store.Store(tmp_path, BOTH.spec(), Shard(2, 2)).close()
    other = dataclasses.replace(BOTH, seed=6)
    with pytest.raises(RigError, match="another campaign; it differs in seed; choose another"):
        store.Store(tmp_path, other.spec(), Shard(2, 2))
    first.close()


def test_a_row_costs_no_memory_and_is_read_back_as_it_was(tmp_path: Path) -> None:
    metrics = {f"metric_{i}": i / 3.0 for i in range(20)} | {"inf": -math.inf}
    rows = store.Store(tmp_path, BOTH.spec(), WHOLE)
    tracemalloc.start()
    for i in range(4000):
        rows.add([RunVerdict(i, "pid", 2**30 + i, {}, RAN, None, metrics=metrics)])
    each = tracemalloc.get_traced_memory()[0] / len(rows)
    tracemalloc.stop()
    assert each < 50, f"{each:.0f} B a row in memory"
    assert rows[3999, "pid"] == RunVerdict(
        3999, "pid", 2**30 + 3999, {}, RAN, None, metrics=metrics
    )
    assert (4000, "pid") not in rows and (1, "pd") not in rows
    rows.close()


def test_a_table_in_chunks_has_the_columns_of_all_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = store.Store(tmp_path, BOTH.spec(), WHOLE)
    some = ({"a": 1.0}, {}, {"b": 2.0, "a": 3.0}, {"c": 4.0}, {})
    for i, own in reversed(list(enumerate(some))):
        held = dict.fromkeys((f"held {n}" for n in own), None)
        rows.add([RunVerdict(i, "pid", i, {"x": 0.5}, RAN, True, "", own, {"m": None}, held)])
    whole = rows.table()
    monkeypatch.setattr(store, "CHUNK", 1)
    chunked = rows.table()
    rows.close()
    assert whole.schema.equals(chunked.schema, check_metadata=True)
    assert repr(whole.to_pylist()) == repr(chunked.to_pylist())
    assert whole.column_names == [
        "draw", "controller", "seed", "vary:x", "metric:a", "metric:b", "metric:c", "margin:m",
        "held:held a", "held:held b", "held:held c", "ok", "why", "outcome", "alone",
    ]  # fmt: skip
    assert repr(whole["metric:a"].to_pylist()) == "[1.0, nan, 3.0, nan, nan]"
    assert repr(whole["margin:m"].to_pylist()) == "[nan, nan, nan, nan, nan]"


@pytest.mark.parametrize(
    ("vary", "what"),
    [
        ("motor.coulomb_NM=1:2", "has no setting motor.coulomb_NM; did you mean motor.coulomb_Nm"),
        ("seed=1:9", "each run has a seed of its own"),
        ("reference.start_s=xchoice(1,2)", ""),
        ("motor.viscous_Nms_rad=xbeta(1,2)", "unknown distribution"),
    ],
)
def test_a_wrong_name_or_distribution_is_told_before_a_run(vary: str, what: str) -> None:
    campaign = dataclasses.replace(BOTH, vary=(vary,))
    if not what:
        campaign.check()
        return
    with pytest.raises(RigError, match=what):
        campaign.check()


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("motor.coulomb_Nm=0.1", r"--vary motor\.coulomb_Nm=1:2 replaces it in every run"),
        ("seed=3", "each run has a seed of its own; --seed gives"),
        ("controller=pd", "--controller pid is another; leave one out"),
        ("reference.start_s=0.2", ""),
    ],
)
def test_a_setting_that_no_run_would_have_is_refused(text: str, what: str) -> None:
    vary = ("motor.coulomb_Nm=1:2",)
    campaign = dataclasses.replace(BOTH, controllers=("pid",), vary=vary, settings=(text,))
    if what:
        with pytest.raises(RigError, match=f"--set {text}: .*{what}"):
            campaign.check()
        return
    campaign.check()
    dataclasses.replace(
        campaign, vary=("motor.coulomb_Nm=x0.5:2",), settings=("motor.coulomb_Nm=0.1",)
    ).check()


def test_what_is_out_of_range_or_diverges_is_counted_and_the_rest_goes_on() -> None:
    bench = Bench(Path(RIG), "pid", SHORT)
    values = [19e-6, -1.0, 1e-9, 19e-6, 2e4, 19e-6, 19e-6, 19e-6]
    rows = bench.rows([Draw(i, 7, {"motor.inertia_kg_m2": v}) for i, v in enumerate(values)])
    assert [row.outcome for row in rows] == [
        RAN, REFUSED, rows[2].outcome, RAN, REFUSED, RAN, RAN, RAN,
    ]  # fmt: skip
    assert "motor.inertia_kg_m2 = -1 is outside 1e-09..1000 kg m^2" in rows[1].why
    left = [f"{name} was not judged: {why}" for name, why in rows[0].unjudged.items()]
    assert (rows[0].ok, rows[0].why, rows[1].unjudged) == (None, left[0], {})
    alone = Bench(Path(RIG), "pid", SHORT).rows([Draw(0, 7, {"motor.inertia_kg_m2": 1e-9})])
    assert (rows[2].ok, rows[2].metrics) == (alone[0].ok, alone[0].metrics)
    assert (
        len({repr(row.metrics) for row in rows if row.values["motor.inertia_kg_m2"] == 19e-6}) == 1
    )


def test_a_fault_is_a_failure_and_a_refused_or_unjudged_run_is_not_counted() -> None:
    outcomes = [RAN, RAN, FAULT, REFUSED, RAN]
    assert counts(outcomes, [True, False, False, False, True]) == (2, 4, 0)
    assert counts(outcomes, [True, False, None, None, None]) == (2, 3, 1)
    assert Counts(1, 4, 2).plus(Counts(2, 3, 5)) == (3, 7, 7)


def test_a_statement_ends_a_campaign_at_the_same_draw_by_any_threads(tmp_path: Path) -> None:
    campaign = dataclasses.replace(BOTH, controllers=("pid",), draws=100_000, settings=())
    until = "p_fail(it arrives and stays) < 0.02 at 90%"
    found = [done(campaign, tmp_path / str(n), threads=n, until=until) for n in (1, 3)]
    assert found[0][1] == found[1][1] and "holds at 90 %: 0 failures" in found[0][1]
    enough = -(-statements.parse(until).without_failure // LOOK) * LOOK
    assert LOOK < len(found[0][0]) == len(found[1][0]) == enough
    read = pyarrow.parquet.read_table(tmp_path / "1" / "sweep.parquet")
    assert read.num_rows == len(found[0][0])


def test_a_statement_counts_every_controller(tmp_path: Path) -> None:
    rows, told = done(
        dataclasses.replace(BOTH, draws=10_000, settings=()), tmp_path, until="p_fail < 0.5 at 90%"
    )
    assert len(rows) == 2 * LOOK
    for name, line in zip(BOTH.controllers, told.splitlines(), strict=True):
        good = [row.ok for row in rows.values() if row.controller == name]
        assert f"{name}: p_fail < 0.5" in line
        assert statements.count_text(good.count(False), "failure") + f" in {LOOK} runs" in line


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--until", "p_fail < 0.1 at 90%", "--sampling", "sobol"], "leave --sampling out"),
        (["--until", "p_fail(it arives) < 0.1 at 90%"], "did you mean it arrives and stays?"),
    ],
)
def test_a_statement_that_would_not_hold_is_refused(
    words: list[str], what: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["sweep", RIG, "--vary", VARY[0], *words, "-o", str(tmp_path / "a")]) == 2
    assert what in capsys.readouterr().err and not (tmp_path / "a").exists()


def test_the_same_campaign_from_python_and_in_a_folder_that_goes_on(
    whole: Path, tmp_path: Path
) -> None:
    vary = dict(one.split("=", 1) for one in VARY)
    changed = dict(pair(setting) for setting in SHORT)
    many = pcpc.sweep(
        RIG,
        BOTH.controllers,
        vary=vary,
        draws=21,
        sampling="random",
        seed=5,
        set=changed,
        folder=tmp_path,
    )
    assert many.table.to_pylist() != [] and rows_of(tmp_path) == rows_of(whole)
    assert many.failures("pid", "it arrives and stays")[1] == 21 and len(many.to_pandas()) == 42
    assert many.failures("pid") == (0, 0), "another window: what the rig expects is not judged"
    assert many.report().stat().st_size > 10_000
    with pytest.raises(pcpc.Error, match="has no setting motor"):
        pcpc.sweep(RIG, vary={"motor.x": "1:2"}, draws=3)


def test_what_is_not_installed_is_told_before_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    found = extras.find_spec
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == "cma" else found(name))
    with pytest.raises(pcpc.Error, match=r"a sweep needs cma: .* -m pip install 'cma~="):
        pcpc.sweep(RIG, draws=1)
