"""The commit of a rig goes from its folder into log, summary, info, report and comparison."""

import json
import shutil
import subprocess
from pathlib import Path

from logcommand import run, run_here

import pcpc
from pcpc.executive.log import reader as logs
from pcpc.tools.make import new
from pcpc.tools.start.folder import LOG


def git(folder: Path, *words: str) -> str:
    """Return what git says in a folder."""
    author = "-c", "user.name=a", "-c", "user.email=a@b.c"
    done = subprocess.run(
        ["git", "-C", str(folder), *author, *words], check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


def test_log_summary_info_report_and_comparison_tell_it(tmp_path: Path) -> None:
    rig = tmp_path / "motor"
    new.write(rig)
    git(rig, "init", "-q")
    git(rig, "add", ".")
    git(rig, "commit", "-qm", "one")
    commit = git(rig, "rev-parse", "--short=12", "HEAD")
    runs = [tmp_path / name for name in ("old", "new", "without")]
    short = {"duration_s": 0.05}
    for folder in runs:
        pcpc.simulate(rig, set=short, folder=folder, quiet=True)
        if folder == runs[0]:
            (rig / "README.md").write_text("changed\n")
        else:
            shutil.rmtree(rig / ".git", ignore_errors=True)
    found = {name: fact.get("rig_git") for name, fact in logs.read(runs[1] / LOG).metadata.items()}
    assert found["executive"] == found["plant"] == f"{commit}-dirty", found
    told = [json.loads((folder / "summary.json").read_text())["rig_git"] for folder in runs]
    assert told == [commit, f"{commit}-dirty", ""]
    for folder, text in zip(runs, told, strict=True):
        assert json.loads(run("info", folder, "--json").out)["rig_git"] == text
        assert (f"rig's commit  {text}\n" in run("info", folder).out) is bool(text)
        done = run_here("report", folder, "-o", tmp_path / f"{folder.name}.html", "--quiet")
        page = (tmp_path / f"{folder.name}.html").read_text()
        assert done.code == 0 and ("rig at commit" in page) is bool(text)
        assert f"rig at commit {text}," in page or not text
    line = f"commit of the rig {commit} -> {commit}-dirty: motor (pid)"
    out = run_here("compare", *runs[:2], "--quiet")
    assert out.code == 0 and line in out.out and "equal to the bit" in out.out, out
    assert f"- {line}" in run_here("compare", *runs[:2], "--markdown", "-", "--quiet").out
    (pair,) = json.loads(run_here("compare", *runs[:2], "--json", "-", "--quiet").out)["pairs"]
    assert pair["commit"] == {"name": "commit", "old": commit, "new": f"{commit}-dirty"}
    for two in (runs[1:], (runs[0], runs[0])):
        assert "commit" not in run_here("compare", *two, "--quiet").out
