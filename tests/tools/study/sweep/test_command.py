"""`pcpc sweep` in wrong words: refused in a line, before a run is done, and nothing is left."""

import math
from pathlib import Path
from typing import Any

import pytest
from places import ROOT

import pcpc
from pcpc.tools.cli import main

RIG = str(ROOT / "tools/make/template/rig.yaml")
VARY = ("--vary", "motor.coulomb_Nm=x0.5:2")
HUGE = "1" + "0" * 20


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the line of a command that is refused."""
    try:
        code = main(words)
    except SystemExit as error:  # of argparse
        code = int(error.code or 0)
    said = capsys.readouterr()
    assert (code, said.out) == (2, ""), said
    assert "Traceback" not in said.err and not list(Path().iterdir())
    return said.err


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--until", ""], "--until '': expected p_fail < 1e-3 at 95%"),
        (["--until", "p_fail < 2 at 95%"], "2 is no probability between 0 and 1"),
        (["--until", "p_fail < 0.1 at 95%", "--shard", "1/2"], "leave --shard out"),
        (["--draws", "0"], "--draws 0: expected a whole number from 1 to 10000000"),
        (["--draws", HUGE], f"--draws {HUGE}: expected a whole number from 1 to 10000000"),
        (["--worst", HUGE], f"--worst {HUGE}: expected"),
        (["--rare", HUGE], f"--rare {HUGE}: expected"),
        (["--worst", "0"], "--worst 0: expected"),
        (["--seed", "-1"], "--seed: expected a whole number from 0 to"),
        (["--seed", HUGE], "--seed: expected a whole number from 0 to"),
        (["--seed", "1.5"], "--seed: expected a whole number from 0 to"),
        (["--on-bus"], "pcpc sweep: no option --on-bus"),
        (["--threads", "0"], "--threads 0: expected a whole number from 1 to 1024"),
        (["--threads", HUGE], f"--threads {HUGE}: expected"),
        (["--threads", "2", "--scheduler", "local"], "workers of --scheduler have their own"),
        (["--scheduler", ""], "--scheduler '': expected"),
        (["--shard", ""], "--shard : expected i/N"),
        (["--shard", "3/2"], "--shard 3/2: expected i/N"),
        (["--shard", "\u00b2/2"], "expected i/N"),
        (["--controllers", ""], "--controllers '': expected names"),
        (["--controllers", "pid,"], "--controllers 'pid,': expected names"),
        (["--controllers", "pid,,pd"], "--controllers 'pid,,pd': expected names"),
        (["--controllers", "pd,pd"], "--controllers pd,pd: pd is there twice"),
        (["--controllers", "pid,pd,pid"], "--controllers pid,pd,pid: pid is there twice"),
        (["--controllers", "pic"], "no controller pic; did you mean pid?"),
        (["--limit", "3"], "--of and --limit need --worst or --rare"),
        (["--of", ""], "--of and --limit need --worst or --rare"),
        (["--rare", "20", "--of", "x", "--limit", "nan"], "--limit: expected a number"),
        (["--rare", "20", "--of", "x", "--limit", "inf"], "--limit: expected a number"),
        (["--worst", "20", "--of", ""], "--of '': expected a metric"),
        (["--vary", "motor.coulomb_Nm=1:2"], "already varied"),
        (["-o", ""], "-o '': expected a folder"),
    ],
)
def test_a_campaign_in_wrong_words_is_refused_and_leaves_nothing(
    words: list[str], what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert what in refused(["sweep", RIG, *VARY, *words], capsys)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ([RIG, "pd"], "'pd' is a word too many"),
        ([RIG, "--sampling", "grid"], "nothing is varied"),
        ([RIG, "--sampling", "grid", "--vary", "motor.inertia_kg_m2=1:2:100000000"], "--draws 1"),
        (["merge"], "required: DIR"),
        (["merge", "."], ".: no campaign; expected the folder of a `pcpc sweep`"),
        (["merge", ""], "no campaign"),
        (["merge", "no/such"], "no/such: no campaign"),
        (["merge", RIG], f"{RIG}: no campaign"),
        (["merge", "a", "--draws", "4"], "pcpc sweep merge: no option --draws"),
        (["merge", "a", "--seed", "4"], "pcpc sweep merge: no option --seed"),
        (["merge", "a", *VARY], "pcpc sweep merge: no option --vary"),
        (["merge", "a", "--on-bus"], "pcpc sweep merge: no option --on-bus"),
        (["rerun"], "required: DIR, DRAW"),
        (["rerun", ".", "1"], ".: no campaign"),
        (["rerun", ".", "x"], "x: expected the number of a draw"),
        (["rerun", ".", "\u00b2"], "expected the number of a draw"),
        (["rerun", ".", "1", "--threads", "2"], "pcpc sweep rerun: no option --threads"),
    ],
)
def test_merge_and_rerun_in_wrong_words_are_refused_and_leave_nothing(
    words: list[str], what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert what in refused(["sweep", *words], capsys)


@pytest.mark.parametrize(
    "words",
    [
        ["margin", RIG, "--seed", "-1"], ["margin", RIG, "--seed", HUGE],
    ],
    ids=" ".join,
)  # fmt: skip
def test_a_seed_that_is_none_is_refused_by_every_command(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert "--seed: expected a whole number from 0 to" in refused(words, capsys)


@pytest.mark.parametrize(
    ("about", "what"),
    [
        ({"draws": 1e20}, "--draws 1e"), ({"draws": True}, "--draws True"),
        ({"draws": math.nan}, "--draws nan"), ({"draws": "8"}, "--draws 8"),
        ({"seed": -1}, "--seed -1"), ({"seed": 0.5}, "--seed 0.5"), ({"seed": None}, "--seed None"),
        ({"until": ""}, "--until '': expected"), ({"worst": 10**8}, "--worst 100000000"),
        ({"threads": 0}, "--threads 0"), ({"threads": 1.5}, "--threads 1.5"),
        ({"sampling": "halton"}, "sampling halton: unknown"),
    ],
)  # fmt: skip
def test_a_campaign_from_python_in_wrong_words_is_refused(about: dict[str, Any], what: str) -> None:
    with pytest.raises(pcpc.Error) as error:
        pcpc.sweep(RIG, vary={"motor.coulomb_Nm": "x0.5:2"}, **about)
    assert what in str(error.value)
    assert not list(Path().iterdir())
