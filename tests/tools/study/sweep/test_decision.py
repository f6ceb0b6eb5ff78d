"""What a statement came to: by the rows alone, the same for the campaign, its merge, its report."""

from pathlib import Path
from typing import Any

import pytest
from test_shards import SPEC, row

from pcpc.tools.cli import main
from pcpc.tools.study.engine import NOTHING
from pcpc.tools.study.sweep import decision, shards, store
from pcpc.tools.study.sweep.campaign import Shard
from pcpc.tools.study.sweep.results import FAULT, RAN, REFUSED, Results

UNTIL = "p_fail < 0.1 at 95%"
GOOD: dict[str, Any] = {"outcome": RAN, "ok": True}
BAD: dict[str, Any] = {"outcome": RAN, "ok": False, "why": "it fell"}
STOPPED: dict[str, Any] = {"outcome": FAULT, "ok": True}
LEFT: dict[str, Any] = {"outcome": REFUSED, "ok": False}
UNJUDGED: dict[str, Any] = {"outcome": RAN, "ok": None}


def campaign(
    folder: Path, rows: dict[str, list[dict[str, Any]]], until: str | None = UNTIL
) -> Path:
    """Write a campaign with a statement whose rows came to these, by controller."""
    spec = SPEC | {"draws": 10_000, "controllers": list(rows)}
    spec |= {"until": until} if until else {"draws": len(next(iter(rows.values())))}
    own = store.Store(folder, spec, Shard())
    for name, all_of in rows.items():
        own.add(
            type(old)(**{**vars(old), **one})
            for draw, one in enumerate(all_of)
            for old in [row(draw, name)]
        )
    own.complete()
    own.close()
    return folder


def texts(folder: Path) -> list[str]:
    table, spec = shards.merge([folder])
    return [one.text for one in decision.decisions(Results(table, spec), spec["until"])]


@pytest.mark.parametrize(
    ("rows", "said", "code"),
    [
        ([GOOD] * 64, "holds at 95 %: 0 failures in 64 runs", 0),
        ([BAD] * 64, "is refuted at 95 %: 64 failures in 64 runs", 1),
        ([STOPPED] * 64, "is refuted at 95 %: 64 failures in 64 runs", 1),
        ([GOOD] * 40, "holds at 95 %: 0 failures in 40 runs", 0),
        ([GOOD] * 20, "is open after 0 failures in 20 runs", 1),
        ([GOOD] * 58 + [BAD] * 6, "is not shown: 6 failures in 64 runs", 1),
        ([GOOD] * 52 + [LEFT] * 12, "0 failures in 52 runs", 0),
        ([GOOD] * 52 + [LEFT] * 12, "not counted: 12 refused", 0),
        ([GOOD] * 63 + [UNJUDGED], "0 failures in 64 runs, bound", 0),
        ([GOOD] * 63 + [UNJUDGED], "without failure; 1 not judged, counted as failures", 0),
        ([GOOD] * 44 + [LEFT] * 12 + [UNJUDGED] * 8, "is not shown: 0 failures in 52 runs", 1),
        ([GOOD] * 400 + [UNJUDGED] * 400, "holds at 95 %: 0 failures in 64 runs", 0),
        ([GOOD, UNJUDGED] * 400, "is not shown: 0 failures in 64 runs", 1),
        ([GOOD, UNJUDGED] * 400, "32 not judged, counted as failures", 1),
        ([BAD] * 40 + [UNJUDGED] * 24, "is refuted at 95 %: 40 failures in 64 runs", 1),
        ([BAD] * 40 + [UNJUDGED] * 24, "24 not judged, counted as no failures", 1),
        ([BAD] * 12 + [GOOD] * 10 + [UNJUDGED] * 42, "is not shown: 12 failures in 64", 1),
        ([UNJUDGED] * 64, "is not shown: 0 failures in 64 runs", 1),
    ],
)
def test_a_statement_is_met_by_its_rows_alone_and_the_exit_code_says_so(
    rows: list[dict[str, Any]],
    said: str,
    code: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = campaign(tmp_path / "a", {"pid": rows, "pd": [GOOD] * len(rows)})
    (folder / "outcome.txt").write_text("pid: p_fail < 0.1 holds")
    assert main(["sweep", "merge", str(folder)]) == code
    told = " ".join(capsys.readouterr().out.split())
    assert said in texts(folder)[0] and texts(folder)[0] in told
    assert said in " ".join((folder / "report.html").read_text().split())


def of(held: bool | None, name: str = "calm", ok: bool | None = True) -> dict[str, Any]:
    """Return what a run came to, of a requirement that it held or not, or was not judged by."""
    left = {name: "no step"} if held is None and ok else {}
    why = "".join(f"{name} was not judged: {one}" for one in left.values())
    return {"outcome": RAN, "ok": None if left else ok and held, "why": why, "unjudged": left,
            "margins": {name: None}, "held": {name: held}}  # fmt: skip


NEVER = "calm was judged in no run"
TOLD = {"outcome": RAN, "ok": None, "why": "m was not judged: too short"}
SHORT = TOLD | {"unjudged": {"m": "too short"}}
TWO = SHORT | {"unjudged": {"n": "gone", "m": "too short"}}


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ({"pid": [of(None)] * 24}, f"{NEVER}: no step"),
        ({"pid": [of(None), LEFT]}, f"{NEVER}: no step"),
        ({"pid": [of(None), BAD | of(None, ok=False)]}, f"{NEVER}: no step"),
        ({"pid": [BAD | of(None, ok=False)] * 2}, NEVER),
        ({"pid": [of(None)] * 2, "pd": [of(True)] * 2}, f"{NEVER} of pid: no step"),
        ({"pid": [of(True, "arrives")], "pd": [of(None)]}, f"{NEVER}: no step"),
        ({"pid": [of(None)] * 2, "pd": [of(None)] * 2}, f"{NEVER}: no step"),
        ({"pid": [BAD | of(None, ok=False)], "pd": [of(None)]}, f"{NEVER}: no step"),
        ({"pid": [of(None)] * 23 + [of(True)]}, ""),
        ({"pid": [of(None)] * 23 + [of(False)]}, ""),
        ({"pid": [of(False)] * 2}, ""),
        ({"pid": [STOPPED | {"margins": {"calm": None}, "held": {"calm": None}}]}, ""),
        ({"pid": [of(True)], "pd": [of(True, "arrives")]}, ""),
        ({"pid": [of(True)], "pd": [of(False, "arrives")]}, ""),
        ({"pid": [GOOD] * 2}, ""),
        ({"pid": [UNJUDGED] * 2}, ""),  # a rig that requires nothing
        ({"pid": [SHORT] * 2}, "m was judged in no run of pid: too short"),
        ({"pid": [SHORT, STOPPED]}, ""),
        ({"pid": [SHORT, GOOD]}, ""),
        ({"pid": [BAD, SHORT]}, ""),
        ({"pid": [GOOD] * 2, "pd": [SHORT] * 2}, "m was judged in no run of pd: too short"),
        ({"pid": [TWO, SHORT]}, "m was judged in no run of pid: too short"),
        ({"pid": [TWO] * 2}, "n was judged in no run of pid: gone"),
        ({"pid": [of(None), of(None) | {"unjudged": {"calm": "no step", "m": "x"}}]}, NEVER),
        ({"pid": [of(True) | SHORT, of(None) | SHORT]}, ""),
        ({"pid": [of(False) | {"why": "", "ok": False}, of(None) | SHORT]}, ""),
    ],
)
def test_a_requirement_that_no_run_judges_is_no_pass(
    rows: dict[str, list[dict[str, Any]]],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = campaign(tmp_path, rows, until=None)
    assert main(["sweep", "merge", str(folder)]) == bool(said)
    told = " ".join(capsys.readouterr().out.split())
    lines = told.count("was judged in no run")
    assert (lines, said in told) == (bool(said), True), told


def test_rows_of_an_earlier_version_tell_it_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, (row_, code) in enumerate(((TOLD, 1), (UNJUDGED | {"why": NOTHING}, 0))):
        folder = campaign(tmp_path / str(number), {"pid": [row_] * 2}, until=None)
        assert main(["sweep", "merge", str(folder)]) == code
        assert ("pid: m was not judged: too short" in capsys.readouterr().out) == bool(code)


def test_a_statement_on_one_requirement_needs_no_other(tmp_path: Path) -> None:
    rows = [{**of(None), "margins": {"calm": None, "arrives": 1.0},
             "held": {"calm": None, "arrives": True}}] * 64  # fmt: skip
    folder = campaign(tmp_path, {"pid": rows}, "p_fail(arrives) < 0.1 at 95%")
    assert main(["sweep", "merge", str(folder)]) == 0


def test_rows_behind_the_decision_are_not_counted(tmp_path: Path) -> None:
    """They are there where another controller took longer, and no look was due among them."""
    folder = campaign(
        tmp_path,
        {
            "pid": [GOOD] * 64 + [BAD] * 64,
            "pd": ([GOOD] * 31 + [BAD]) * 4,
        },
    )
    assert "pid: p_fail < 0.1 holds at 95 %: 0 failures in 64 runs" in texts(folder)[0]
    assert "4 failures in 128 runs" in texts(folder)[1]


def test_looks_come_at_the_same_draws_however_long_it_takes() -> None:
    sizes = decision.blocks()
    ends = [next(sizes) for _ in range(60)]
    assert ends[:16] == [64] * 16 and ends[-1] > 64 and sum(ends) > 5000
