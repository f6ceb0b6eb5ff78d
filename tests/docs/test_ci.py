"""The workflow of docs/howto/ci.md: its steps are carried out in a clean environment.

A fresh repository with a user's rig, an empty home, nothing of this environment. The step on vcan0
boots a machine for minutes: tools/vcan_stage.sh runs this file with it, `make test` without.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from blocks import ROOT, blocks_of
from wheel_file import wheel_file

from pcpc.drivers.compiled.compile_cache import user_cache
from pcpc.tools import cli

pytestmark = pytest.mark.deep

(_TEXT,) = [b.text for b in blocks_of(ROOT / "docs/howto/ci.md") if b.text.startswith("# .github/")]
WORKFLOW, WORKFLOW_FILE = yaml.safe_load(_TEXT), _TEXT.split()[1]
REQUIREMENTS, *_ = [b.text for b in blocks_of(ROOT / "docs/howto/ci.md") if b.language == "text"]
JOB = WORKFLOW["jobs"]["rigs"]
STEPS: dict[str, dict[str, Any]] = {s["name"]: s for s in JOB["steps"] if "run" in s}
PACKAGES, ON_VCAN = "packages for a machine with CAN", "the same on a CAN interface of the kernel"
WITH_VCAN = "PCPC_CI_ON_VCAN" in os.environ
LIMITS = "the rig in virtual time, with its limits"
COMMENT, SAME = "tell it under the pull request", "all three have the same bits"
GH = """#!/bin/sh
printf '%s\\n' "$@" > "$HOME/words"
for last; do :; done
cp "$last" "$HOME/comment.md"
"""


class Runner:
    """A machine that has Python with pcpc, git and a checked-out pull request, and no more."""

    def __init__(self, folder: Path, wheel: Path, kp_V_rad: str) -> None:
        self.home, self.repo = folder / "home", folder / "repo"
        (self.home / ".cache").mkdir(parents=True)
        programs = self.home / "bin"
        programs.mkdir()
        (programs / "gh").write_text(GH)
        (programs / "gh").chmod(0o755)
        self.environment = {
            "HOME": str(self.home), "LANG": "C.UTF-8", "CI": "true", "GITHUB_BASE_REF": "main",
            "GITHUB_STEP_SUMMARY": str(self.home / "summary.md"),
            "PATH": f"{programs}:{Path(sys.executable).parent}:/usr/bin:/bin", **WORKFLOW["env"],
        }  # fmt: skip
        cache = user_cache()
        assert cache is not None
        (cache / "pcpc").mkdir(parents=True, exist_ok=True)
        (self.home / ".cache/pcpc").symlink_to(cache / "pcpc")  # as actions/cache brings it
        origin = folder / "origin.git"
        self.run(f"git init -q -b main {self.repo}; git init -q -b main --bare {origin}", folder)
        self.run("git config user.name me; git config user.email me@example.org; pcpc new motor")
        (self.repo / "wheels").mkdir()
        shutil.copy(wheel, self.repo / "wheels")
        (self.repo / "requirements.txt").write_text(REQUIREMENTS)
        self.run(f"git add .; git commit -q -m one; git remote add origin {origin}")
        self.run("git push -q origin main; git checkout -q -b stiffer")
        rig = self.repo / "motor/rig.yaml"
        rig.write_text(rig.read_text().replace("kp_V_rad: 30.0", f"kp_V_rad: {kp_V_rad}"))
        self.run("git commit -q -a -m two")

    def job(self) -> dict[str, bool]:
        """Carry out the steps as the service does; return which of them were, and which held."""
        held: dict[str, bool] = {}
        for name, step in STEPS.items():
            if name == PACKAGES or (name == ON_VCAN and not WITH_VCAN) or not due(step, held):
                continue
            if name == SAME and not WITH_VCAN:
                shutil.copytree(self.repo / "runs/lockstep", self.repo / "runs/vcan0")
            given = {key: re.sub(r"\$\{\{.*\}\}", "7", v) for key, v in step.get("env", {}).items()}
            if name == "install":
                given["PIP_DRY_RUN"] = "1"  # this environment is that of all tests
            try:
                self.run(step["run"], **given)
                held[name] = True
            except AssertionError:
                held[name] = False
        return held

    def run(self, script: str, folder: Path | None = None, **more: str) -> str:
        """Run a script as a step is run; return what it printed."""
        done = subprocess.run(
            ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", script],
            cwd=folder or self.repo,
            env=self.environment | more,
            text=True,
            check=False,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
        )
        assert done.returncode == 0, f"{script}\nended with {done.returncode}\n{done.stdout}"
        return done.stdout


def due(step: dict[str, Any], held: dict[str, bool]) -> bool:
    """Return whether a step is carried out after others of which these held."""
    asked = str(step.get("if", ""))
    ids = {STEPS[name]["id"]: good for name, good in held.items() if "id" in STEPS[name]}
    needed = re.findall(r"steps\.(\w+)\.outcome == 'success'", asked)
    return ("!cancelled()" in asked or all(held.values())) and all(ids.get(n) for n in needed)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return wheel_file(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Runner:
    """Return a machine on which the steps were carried out, in their order."""
    runner = Runner(tmp_path_factory.mktemp("ci"), wheel, "31.0")
    held = runner.job()
    assert all(held.values()), held
    return runner


def test_behind_a_failed_limit_the_table_comes_all_the_same(tmp_path: Path, wheel: Path) -> None:
    runner = Runner(tmp_path, wheel, "300.0")
    held = runner.job()
    assert [name for name, good in held.items() if not good] == [LIMITS], held
    comment = (runner.home / "comment.md").read_text()
    assert "controllers.pid.parameters.kp_V_rad 30 -> 300" in comment, comment


def test_the_requirement_names_the_wheel(wheel: Path) -> None:
    assert f"./wheels/{wheel.name}[plot]\n" == REQUIREMENTS


def test_the_comment_names_the_rig_the_metric_and_the_first_cycle(runner: Runner) -> None:
    comment = (runner.home / "comment.md").read_text()
    assert comment.startswith("### pcpc compare: 1 changed\n"), comment
    assert re.search(
        r"^\| motor, pid \| from cycle 1\d\d \(0\.1\d\d s\) on, first controller\.",
        comment,
        re.MULTILINE,
    ), comment
    assert re.search(r"^\|  \|  \| \w+ \| \S+ \| \S+ \| [+-]\S+ % \|$", comment, re.MULTILINE)
    assert "controllers.pid.parameters.kp_V_rad 30 -> 31" in comment, comment
    words = (runner.home / "words").read_text().split("\n")
    assert words[:3] == ["pr", "comment", "7"], words


def test_the_table_of_the_page_is_the_one_that_comes(runner: Runner) -> None:
    text = (ROOT / "docs/howto/ci.md").read_text("utf-8").partition("## The table\n")[2]
    rows = [line for line in text.splitlines() if line.startswith("|")]
    comment = (runner.home / "comment.md").read_text().splitlines()
    assert rows == [line for line in comment if line.startswith("|")]


def test_what_is_kept_is_there(runner: Runner) -> None:
    (kept,) = [step["with"]["path"] for step in JOB["steps"] if "upload" in step.get("uses", "")]
    assert all((runner.repo / name).exists() for name in kept.split("\n")), kept
    report = (runner.repo / "compared/report.md").read_text()
    assert (
        "![motor, pid](motor-pid.png)" in report
        and (runner.repo / "compared/motor-pid.png").is_file()
    )
    assert (runner.home / "summary.md").read_text() == report


def test_nothing_of_the_machine_was_needed(runner: Runner) -> None:
    left = {path.name for path in runner.home.iterdir()}
    assert left <= {".cache", ".config", "bin", "words", "comment.md", "summary.md"}, left
    status = runner.run("git status --short -- ':!*__pycache__*'")
    assert status == "?? compared/\n?? runs/\n?? table.json\n?? table.md\n"


def test_the_packages_are_those_of_make_vcan_tools() -> None:
    def packages(text: str) -> list[str]:
        found = re.search(r"--no-install-recommends \\\n(.*)", text)
        assert found is not None
        return found[1].split()

    assert packages(STEPS[PACKAGES]["run"]) == packages((ROOT / "Makefile").read_text())


def test_the_step_on_vcan0_is_a_command_line() -> None:
    words = shlex.split(STEPS[ON_VCAN]["run"].replace("$RIG", "motor"))
    options = cli.parsed_options(words[1:])
    inner = cli.parsed_options(options.rest[1:])
    assert (words[0], options.rest[0], options.timeout_s) == ("pcpc", "pcpc", 1200.0)
    assert (inner.command, inner.bus, inner.pacing, inner.output) == (
        "run", "vcan0", "lockstep", "runs/vcan0",
    )  # fmt: skip


def test_actions_are_named_with_their_versions() -> None:
    used = [step["uses"] for step in JOB["steps"] if "uses" in step]
    assert used and all(re.fullmatch(r"actions/[a-z-]+@v\d+", name) for name in used), used
    assert os.path.basename(WORKFLOW_FILE) == "rigs.yaml"
