"""`pcpc bisect`: what it prints of real runs, what it refuses, and what it leaves alone."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from bisected import (
    RIG,
    TAU,
    ULP_MORE,
    begun,
    bisected,
    commit,
    edit,
    git,
    in_this_process,
    note,
    state,
)
from json_schemas import holds, strictly_holds
from logcommand import run_here

from pcpc.drivers.errors import Exit
from pcpc.tools.after.bisect import cli, runs
from pcpc.tools.after.bisect.commands import BisectRequest
from pcpc.tools.after.bisect.runs import First
from pcpc.tools.after.compare.repository import Repository
from pcpc.tools.after.compare.versions import Side
from pcpc.tools.terminal import screen

QUIET = "--duration", "0.01s", "--quiet"


@pytest.fixture(scope="module")
def history(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a repository of eight commits; that tagged `planted` changes one ULP."""
    folder = begun(tmp_path_factory.mktemp("bisect") / "my \u00fcrig's")
    for number in range(4):
        note(folder, number)
    edit(folder / RIG, TAU, ULP_MORE)
    (folder / "README.md").write_text("words\n")
    commit(folder, "\u00fcber \x1b[31m" + "long " * 20)
    git(folder, "tag", "planted")
    for number in range(4, 6):
        note(folder, number)
    return folder


@pytest.fixture
def sides(monkeypatch: pytest.MonkeyPatch) -> list[Side]:
    return in_this_process(monkeypatch)


@pytest.fixture
def repo(tmp_path: Path, sides: list[Side]) -> Path:
    return begun(tmp_path / "repo")


def told(*words: str | Path, code: int = 0) -> dict[str, Any]:
    return dict(strictly_holds("bisect", bisected(*words, *QUIET, "--json", code=code).out))


def refused(*words: str | Path, code: int = 2) -> str:
    done = bisected(*words, *QUIET, code=code)
    assert done.err.count("\n") == 1 and not done.out and "Traceback" not in done.err, done
    return done.err


def test_one_ulp_is_found_with_its_commit_cycle_and_signal(
    history: Path, sides: list[Side], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = state(history)
    found = told(history / "motor", "good", "HEAD")
    (suspect,) = found["suspects"]
    assert suspect["commit"] == git(history, "rev-parse", "planted")
    assert found["parent"] == git(history, "rev-parse", "planted~")
    assert suspect["date"] == git(history, "show", "-s", "--format=%aI", "planted")
    assert found["files"] == [RIG, "README.md"], "those of the rig's folder first"
    assert found["runs"] == len(sides) in (6, 7) and found["cycles"] == 10
    (node,) = found["nodes"]
    tau = 0.1, 0.10000000000000002
    values = [0.001 / one * 4.0 for one in tau]
    assert [float(node[key]) for key in ("old", "new")] == values
    assert (node["node"], node["cycle"], node["stage"], node["name"], node["ulp"]) == (
        "plant", 1, "block lag", "lag.x", 1,
    )  # fmt: skip
    assert node["time_s"] == 0.001 and node["others"] == 2
    assert state(history) == before
    monkeypatch.chdir(history / "motor")
    text = bisected(".", "planted~2", "HEAD~1", "--duration", "10ms")
    lines = text.out.splitlines()
    assert lines[0].startswith(f"commit   {suspect['commit'][:10]}  {suspect['date']}")
    assert "\x1b" not in text.out and all(len(line) <= 80 for line in lines), text
    assert lines[-2] == "plant, cycle 1 (0.001 s), block lag", text
    assert lines[-1] == "  lag.x: 0.04 -> 0.039999999999999994, 1 ULP; 2 more in this cycle"
    assert f"changed  {RIG}, README.md" in lines
    assert text.err.startswith("running GOOD, "), text


def test_equal_bits_are_nothing_to_find(history: Path, sides: list[Side]) -> None:
    found = told(history / "motor", "good", "planted~", code=1)
    assert found["suspects"] == [] and found["runs"] == len(sides) == 2
    (text,) = cli._lines(found)
    assert text.endswith("equal bits up to cycle 9, nothing to find") and len(text) < 80
    still = told(history / "motor", "good", "HEAD", "--set", "controller.target=0", code=1)
    assert still["runs"] == 2 and not still["suspects"], "the change has no effect in this run"


def test_each_run_is_as_asked(
    history: Path, sides: list[Side], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tuned.yaml").write_text("lag.tau_s: 0.2\n")
    monkeypatch.chdir(tmp_path)
    words = "--set", "@tuned.yaml", "--controller", "proportional", "--set", "lag.tau_s=0.25"
    asked = BisectRequest(rig="", good="", bad="", set=["@tuned.yaml", "a=-1"])
    assert list(cli._words(asked)) == [f"--set=@{tmp_path}/tuned.yaml", "--set=a=-1"]
    for n in (2, 4):
        found = told(history / "motor", "good", "HEAD", *words[:n], code=1)
        assert found["suspects"] == [], "both runs have the same tau"
    assert "cannot be run: " in refused(history / "motor", "good", "HEAD", "--controller", "pd")


def test_what_is_not_committed_has_no_say(history: Path, sides: list[Side], tmp_path: Path) -> None:
    folder = tmp_path / "clone"
    git(tmp_path, "clone", "-q", str(history), str(folder))
    git(folder, "checkout", "-q", "--detach", "good")
    edit(folder / RIG, "gain: 4.0", "gain: 5.0")
    git(folder, "add", RIG)
    edit(folder / RIG, "gain: 5.0", "gain: 6.0")
    (folder / ".gitattributes").write_text("*.yaml eol=crlf\n")
    (folder / "sitecustomize.py").write_text("raise SystemExit(9)\n")
    (folder / "untracked.py").write_text("1\n")
    before = git(folder, "status", "--porcelain"), (folder / ".git/index").read_bytes()
    found = told(folder / "motor", "planted~", "planted")
    assert found["uncommitted"] == 4
    assert next(cli._lines(found)) == "uncommitted files, left out: 4"
    assert (git(folder, "status", "--porcelain"), (folder / ".git/index").read_bytes()) == before
    with Repository(folder).checked_out(Repository(folder).commit("good")) as written:
        assert b"\r" not in (written / "tree" / RIG).read_bytes()


def test_commits_that_cannot_be_run_are_passed_over_and_named(repo: Path) -> None:
    note(repo, 1)
    edit(repo / "motor/law.py", "y.command =", "y.command = (")
    broken = commit(repo, "broken")
    edit(repo / RIG, TAU, ULP_MORE)
    planted = commit(repo, "planted")
    edit(repo / "motor/law.py", "y.command = (", "y.command =")
    repaired = commit(repo, "repaired")
    found = told(repo / "motor", "good", "HEAD", code=1)
    assert [one["commit"] for one in found["suspects"]] == [broken, planted, repaired]
    assert {one["commit"] for one in found["skipped"]} == {broken, planted}
    assert all("law.py" in one["why"] and "/tmp" not in one["why"] for one in found["skipped"])
    assert found["nodes"][0]["name"] == "lag.x"
    read = {**found, "nodes": [First(**one) for one in found["nodes"]]}
    text = "\n".join(screen.fitted(cli._lines(read)))
    assert "one of 3 commits" in text and text.count("skipped  ") == 2, text
    assert all(len(line) <= 80 for line in text.splitlines()), text
    said = refused(repo / "motor", "good", planted)
    assert said.startswith(f"BAD {planted[:10]} cannot be run: ") and "law.py" in said
    assert refused(repo / "motor", broken, "HEAD").startswith(f"GOOD {broken[:10]} cannot be run")


def test_a_rig_that_is_away_for_a_while_is_passed_over(repo: Path) -> None:
    git(repo, "mv", "motor", "other")
    commit(repo, "renamed")
    git(repo, "mv", "other", "motor")
    edit(repo / RIG, TAU, ULP_MORE)
    commit(repo, "back")
    found = told(repo / "motor", "good", "HEAD", code=1)
    assert [one["why"] for one in found["skipped"]] == [f"{RIG} is not in it"]
    assert len(found["suspects"]) == 2
    (repo / "new.yaml").write_text((repo / RIG).read_text())
    assert "new.yaml: not in GOOD" in refused(repo / "new.yaml", "good", "HEAD")
    shutil.copy(repo / RIG, repo / "motor/later.yaml")
    commit(repo, "later")
    assert "later.yaml: not in GOOD" in refused(repo / "motor/later.yaml", "good", "HEAD")
    git(repo, "rm", "-q", RIG)
    commit(repo, "gone")
    git(repo, "checkout", "-q", "good")
    assert f"{RIG}: not in BAD" in refused(repo / RIG, "good", "main")


def test_a_longer_run_and_another_signal_are_differences_of_their_own(repo: Path) -> None:
    edit(repo / RIG, "duration_s: 0.05", "duration_s: 0.06")
    longer = commit(repo, "longer")
    edit(repo / "motor/model.py", '    x = port("", "of the lag")', '    x2 = port("", "lag")')
    (repo / "motor/model.py").write_text(
        (repo / "motor/model.py").read_text().replace("x.x", "x.x2")
    )
    renamed = commit(repo, "renamed")
    found = holds("bisect", bisected(repo / "motor", "good", "HEAD", "--json", "--quiet").out)
    assert found["suspects"][0]["commit"] == longer
    assert f"only {longer[:10]} has 10 cycles of executive: 50 to 59" in found["only"], found
    assert {one["cycle"] for one in found["nodes"]} == {50, 51}, "frames of cycles that were not"
    found = told(repo / "motor", "good", "HEAD")
    assert found["suspects"][0]["commit"] == renamed and not found["nodes"]
    assert found["only"] == [
        f"only {longer[:10]} has 1 variable: plant.lag.x",
        f"only {renamed[:10]} has 1 variable: plant.lag.x2",
    ]


def test_minus_zero_is_another_number_and_nan_is_nan(repo: Path) -> None:
    edit(repo / RIG, "target: 1.0", "target: 0.0")
    zero = commit(repo, "zero")
    edit(repo / RIG, "target: 0.0", "target: -0.0")
    commit(repo, "minus zero")
    first = told(repo / "motor", zero, "HEAD")["nodes"][0]
    assert (first["name"], first["old"], first["new"], first["ulp"]) == (
        "controller.command", "0.0", "-0.0", 0,
    )  # fmt: skip
    assert (first["node"], first["stage"]) == ("executive", "block controller")


@pytest.mark.parametrize(("since", "which"), [(1, "planted~"), (3, "planted")])
def test_runs_that_differ_from_themselves_are_refused(
    since: int, which: str, history: Path, sides: list[Side], monkeypatch: pytest.MonkeyPatch
) -> None:
    steady = runs.simulation

    def by_chance(side: Side, folder: Path, *more: str) -> "subprocess.CompletedProcess[str]":
        number = len(sides) + 1
        return steady(side, folder, *more, f"--set=controller.gain={max(number, since)}")

    monkeypatch.setattr(runs, "simulation", by_chance)
    said = refused(history / "motor", "planted~", "planted")
    commit = git(history, "rev-parse", which)[:10]
    assert said.startswith(f"{commit}: its runs differ from each other"), said


def test_a_step_that_raises_is_no_run(repo: Path) -> None:
    raising = "if u.position > 0.5:\n        raise ValueError\n    y.command ="
    edit(repo / "motor/law.py", "y.command =", raising)
    commit(repo, "raises")
    edit(repo / "motor/law.py", raising, "y.command =")
    edit(repo / RIG, TAU, ULP_MORE)
    commit(repo, "repaired")
    words = "--set", "duration_s=0.3", "--quiet", "--json"
    found = holds("bisect", bisected(repo / "motor", "good", "HEAD", *words, code=1).out)
    assert len(found["suspects"]) == 2 and found["skipped"][0]["why"], found


@pytest.mark.parametrize("how", ["base", "dbc", "link", "law"])
def test_a_rig_that_reads_the_working_tree_is_refused(how: str, repo: Path) -> None:
    rig = repo / RIG
    if how == "base":
        (repo / "motor/base.yaml").write_text(rig.read_text())
        rig.write_text(f"base: {repo}/motor/base.yaml\nrig: probe\n")
    elif how == "link":
        (repo / "motor/real.yaml").write_text(rig.read_text())
        rig.unlink()
        rig.symlink_to(repo / "motor/real.yaml")
    elif how == "dbc":
        edit(rig, "dbc: probe.dbc", f"dbc: {repo}/motor/probe.dbc")
    else:
        (repo / "motor/k.txt").write_text("1\n")
        edit(
            repo / "motor/law.py",
            "\n@stage",
            f"\nK = float(open('{repo}/motor/k.txt').read())\n@stage",
        )
        edit(repo / "motor/law.py", "y.command =", "y.command = K *")
    commit(repo, how)
    edit(repo / "motor/model.py", "x.x += dt", "x.x += 2.0 * dt")
    commit(repo, "other")
    said = refused(repo / "motor", "HEAD~", "HEAD")
    assert "of the working tree; name it by a path from the rig" in said, said


def test_a_hooks_environment_changes_nothing(
    history: Path, sides: list[Side], repo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("GIT_DIR", ".git"), ("GIT_WORK_TREE", "."), ("GIT_INDEX_FILE", "x")):
        monkeypatch.setenv(name, str(repo / value))
    monkeypatch.chdir(repo)
    before = (history / ".git/index").read_bytes()
    found = told(history / "motor", "planted~", "planted")
    assert found["suspects"][0]["subject"].startswith("\u00fc")
    assert not (repo / "x").exists() and (history / ".git/index").read_bytes() == before


@pytest.mark.parametrize("number", [Exit.LOSS, Exit.INTERRUPTED])
def test_a_disk_that_is_full_and_a_run_that_is_ended_end_the_search(
    number: Exit, history: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def simulated(*_: Any) -> "subprocess.CompletedProcess[str]":
        return subprocess.CompletedProcess([], number, "", "log.mcap: No space left on device\n")

    monkeypatch.setattr(runs, "simulation", simulated)
    assert "No space left" in refused(history / "motor", "good", "HEAD", code=number)


def test_without_repository_git_or_trust_a_line_says_so(
    history: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    shutil.copytree(history / "motor", tmp_path / "motor")
    assert "motor: not in a git repository" in refused(tmp_path / "motor", "good", "HEAD")
    git(tmp_path, "init", "-q", "-b", "main")
    assert "Needed a single revision" in refused(tmp_path / "motor", "HEAD~", "HEAD")
    bare = tmp_path / "bare.git"
    git(tmp_path, "clone", "-q", "--bare", str(history), str(bare))
    shutil.copytree(history / "motor", bare / "motor")
    assert "must be run in a work tree" in refused(bare / "motor", "good", "HEAD")
    assert "no such file" in refused(tmp_path / "none.yaml", "good", "HEAD")
    assert "is not a rig" in refused("", "good", "HEAD")
    monkeypatch.setenv("GIT_TEST_ASSUME_DIFFERENT_OWNER", "1")
    said = refused(history / "motor", "good", "HEAD")
    assert "dubious ownership" in said and "safe.directory FOLDER` trusts it" in said
    monkeypatch.delenv("GIT_TEST_ASSUME_DIFFERENT_OWNER")
    program = tmp_path / "bin/git"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\necho 'error: x: No space left on device' >&2\nexit 128\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}/bin")
    assert "No space left on device" in refused(history / "motor", "good", "HEAD", code=3)
    program.unlink()
    assert "git: no such program; install it" in refused(history / "motor", "good", "HEAD", code=4)


@pytest.mark.parametrize("folder", ["-x", "a b", "\u00e4 '\"$", "motor/deep"])
def test_a_folder_may_have_any_name(
    folder: str, repo: Path, sides: list[Side], monkeypatch: pytest.MonkeyPatch
) -> None:
    (repo / folder).parent.mkdir(exist_ok=True)
    shutil.copytree(repo / "motor", repo / folder, ignore=shutil.ignore_patterns("deep"))
    commit(repo, "there")
    edit(repo / folder / "rig.yaml", TAU, ULP_MORE)
    changed = commit(repo, "changed")
    monkeypatch.chdir(repo)
    found = holds("bisect", bisected(*QUIET, "--json", "--", folder, "HEAD~", "HEAD").out)
    assert (found["rig"], found["suspects"][0]["commit"]) == (f"{folder}/rig.yaml", changed)
    assert {side.rig for side in sides} == {f"./{folder}/rig.yaml"}, "never an option"


def test_a_submodules_rig_is_that_of_its_own_repository(repo: Path, tmp_path: Path) -> None:
    edit(repo / RIG, TAU, ULP_MORE)
    changed = commit(repo, "changed")
    outer = begun(tmp_path / "outer")
    git(outer, "-c", "protocol.file.allow=always", "submodule", "add", "-q", str(repo), "sub")
    commit(outer, "with a submodule")
    git(outer / "sub", "fetch", "-q", "--tags")
    found = told(outer / "sub/motor", "good", "HEAD")
    assert found["suspects"][0]["commit"] == changed
    linked = tmp_path / "linked"
    git(repo, "worktree", "add", "-q", "--detach", str(linked), "good")
    assert told(linked / "motor", "good", "main")["suspects"][0]["commit"] == changed


def test_help_says_whose_code_runs() -> None:
    assert "whose code you would run" in " ".join(run_here("bisect", "--help").out.split())


def test_the_words_of_the_terminal_fit() -> None:
    many: dict[str, Any] = {
        "uncommitted": 0, "cycles": 1, "runs": 2, "good": "a" * 40, "bad": "b" * 40,
        "suspects": [{"commit": "c" * 40, "date": "2026", "subject": "s" * 300}],
        "skipped": [{"commit": "d" * 40, "why": "w " * 99}] * 20, "files": ["f" * 99] * 20,
        "only": ["only a has x" * 20], "nodes": [],
    }  # fmt: skip
    lines = list(screen.fitted(cli._lines(many)))
    assert all(len(line) <= 80 for line in lines) and "12 more" in "\n".join(lines)
    assert sum(line.startswith("skipped") for line in lines) == 8
