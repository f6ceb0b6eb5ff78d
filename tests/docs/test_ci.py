"""The workflow of docs/howto/ci.md, the actions that it uses, and GitLab's: their steps are done.

A fresh repository with a user's rig, an empty home, nothing of this environment. The step on vcan0
boots a machine for minutes: tools/vcan_stage.sh runs this file with it, `make test` without.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from blocks import ROOT, blocks_of
from wheel_file import wheel_file

from pcpc.drivers.compiled.compile_cache import user_cache
from pcpc.tools import cli

pytestmark = pytest.mark.deep

VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
(_TEXT,) = [b.text for b in blocks_of(ROOT / "docs/howto/ci.md") if b.text.startswith("# .github/")]
WORKFLOW, WORKFLOW_FILE = yaml.safe_load(_TEXT), _TEXT.split()[1]
REQUIREMENTS, *_ = [b.text for b in blocks_of(ROOT / "docs/howto/ci.md") if b.language == "text"]
JOB = WORKFLOW["jobs"]["rigs"]
ACTIONS = {
    f"OWNER/pcpc{place}@v{VERSION}": yaml.safe_load((ROOT / file).read_text("utf-8"))
    for place, file in (
        ("", "action.yml"),
        ("/.github/actions/vcan", ".github/actions/vcan/action.yml"),
    )
}
GITLAB = yaml.safe_load((ROOT / ".gitlab/rigs.yml").read_text("utf-8"))


def expanded(steps: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the steps that run something, those of our actions with their inputs."""
    for step in steps:
        if "run" in step:
            yield {"inputs": {}, **step}
        elif (action := ACTIONS.get(step["uses"])) is not None:
            assert set(step["with"]) <= set(action["inputs"]), step
            given = {name: one.get("default", "") for name, one in action["inputs"].items()}
            own = [one for one in action["runs"]["steps"] if "run" in one]
            assert all(one["shell"] == "bash" for one in own), "a composite action says its shell"
            yield from ({"inputs": given | step["with"], **one} for one in own)


STEPS = [*expanded(JOB["steps"])]
PACKAGES, ON_VCAN = "packages for a machine with CAN", "script on vcan0"
WITH_VCAN = "PCPC_CI_ON_VCAN" in os.environ
LIMITS, SAME = "simulate and judge", "all three have the same bits"
GH = """#!/bin/sh
[ ! -e "$HOME/forbidden" ] || exit 1
printf '%s\\n' "$@" > "$HOME/words"
for last; do :; done
cp "$last" "$HOME/comment.md"
"""
CURL = """#!/bin/sh
printf '%s\\n' "$@" > "$HOME/words"
cp table.md "$HOME/comment.md"
"""
_KNOWN = {  # what the service puts in place of an expression
    "github.base_ref": "main", "github.token": "token", "github.event.number": "7",
}  # fmt: skip


class Runner:
    """A machine that has Python with pcpc, git and a checked-out pull request, and no more."""

    def __init__(self, folder: Path, wheel: Path, kp_V_rad: str) -> None:
        self.home, self.repo = folder / "home", folder / "repo"
        (self.home / ".cache").mkdir(parents=True)
        programs = self.home / "bin"
        programs.mkdir()
        for name, text in (("gh", GH), ("curl", CURL)):
            (programs / name).write_text(text)
            (programs / name).chmod(0o755)
        self.environment = {
            "HOME": str(self.home), "LANG": "C.UTF-8", "CI": "true", "GITHUB_BASE_REF": "main",
            "GITHUB_STEP_SUMMARY": str(self.home / "summary.md"),
            "PATH": f"{programs}:{Path(sys.executable).parent}:/usr/bin:/bin",
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
        for step in STEPS:
            name = step["name"]
            if name == PACKAGES or (name == ON_VCAN and not WITH_VCAN) or not due(step, held):
                continue
            if name == SAME and not WITH_VCAN:
                shutil.copytree(self.repo / "runs/lockstep", self.repo / "runs/vcan0")
            given = {key: filled(text, step) for key, text in step.get("env", {}).items()}
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


def filled(text: str, step: dict[str, Any]) -> str:
    """Return a text of a step with what the service puts in place of its expressions."""

    def value(found: re.Match[str]) -> str:
        name = found[1]
        given = step["inputs"].get(name.removeprefix("inputs."))
        return filled(str(given), step) if name.startswith("inputs.") else _KNOWN[name]

    return re.sub(r"\$\{\{ (\S+) \}\}", value, text)


def due(step: dict[str, Any], held: dict[str, bool]) -> bool:
    """Return whether a step is carried out after others of which these held."""
    asked = [one.strip() for one in str(step.get("if", "")).strip("${} ").split("&&") if one]
    done = {one["id"] for one in STEPS if "id" in one and one["name"] in held}
    for term in asked:
        if ran := re.fullmatch(r"steps\.(\w+)\.outcome != 'skipped'", term):
            met = ran[1] in done
        elif found := re.fullmatch(r"(\S+) ([!=]=) '(\w*)'", term):
            met = (filled(f"${{{{ {found[1]} }}}}", step) == found[3]) == (found[2] == "==")
        else:
            assert term in ("!cancelled()", "github.event.number"), term
            met = True
        if not met:
            return False
    return "!cancelled()" in asked or all(held.values())


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


def test_without_permission_to_comment_the_job_is_still_good(runner: Runner) -> None:
    (comment,) = [step for step in STEPS if step["name"] == "comment"]
    assert due(comment, {LIMITS: False, "compare with the base branch": False}), "it failed: told"
    (runner.home / "forbidden").touch()
    told = runner.run(comment["run"], PR="7")
    (runner.home / "forbidden").unlink()
    assert told == "::notice::no permission to comment; the table is in the summary of this job\n"


@pytest.mark.parametrize(("kp_V_rad", "code"), [("31.0", 0), ("300.0", 1)])
def test_gitlab_does_the_same(kp_V_rad: str, code: int, tmp_path: Path, wheel: Path) -> None:
    runner, job = Runner(tmp_path, wheel, kp_V_rad), GITLAB["rigs"]
    named = GITLAB["variables"] | {"RIGS": "motor", "GITLAB_TOKEN": "t", "PIP_DRY_RUN": "1"}
    named |= {"CI_MERGE_REQUEST_TARGET_BRANCH_NAME": "main", "CI_API_V4_URL": "https://host"}
    script = "\n".join([*job["before_script"], *job["script"]])
    runner.run(f"( {script}\n) && came=0 || came=$?; [ $came = {code} ]", **named)
    comment = (runner.home / "comment.md").read_text()
    assert f"controllers.pid.parameters.kp_V_rad 30 -> {kp_V_rad.removesuffix('.0')}" in comment
    assert "PRIVATE-TOKEN: t" in (runner.home / "words").read_text()
    kept = [*job["artifacts"]["paths"], job["artifacts"]["reports"]["junit"]]
    assert [name for name in kept if not (runner.repo / name).exists()] == []


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
    (action, _) = ACTIONS.values()
    steps = action["runs"]["steps"]
    (kept,) = [step["with"]["path"] for step in steps if "upload" in step.get("uses", "")]
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

    (step,) = [one for one in STEPS if one["name"] == PACKAGES]
    assert packages(step["run"]) == packages((ROOT / "Makefile").read_text())


def test_the_step_on_vcan0_is_a_command_line() -> None:
    (step,) = [one for one in STEPS if one["name"] == ON_VCAN]
    words = shlex.split(step["run"].replace("$LIMIT", filled(step["env"]["LIMIT"], step)))
    options = cli.parsed_options(words[1:])
    assert (words[0], options.timeout_s) == ("pcpc", 1200.0)
    assert options.rest == ["bash", "-eo", "pipefail", "-c", "$RUN"]
    pcpc, *rest = shlex.split(filled(step["env"]["RUN"], step))
    inner = cli.parsed_options(rest)
    assert pcpc == "pcpc"
    assert (inner.command, inner.bus, inner.pacing, inner.output) == (
        "run", "vcan0", "lockstep", "runs/vcan0",
    )  # fmt: skip


def test_actions_are_named_with_their_versions() -> None:
    used = [step["uses"] for step in JOB["steps"] if step.get("uses") not in (None, *ACTIONS)]
    assert used and all(re.fullmatch(r"actions/[a-z-]+@v\d+", name) for name in used), used
    steps = [step for one in ACTIONS.values() for step in one["runs"]["steps"]]
    pinned = [step["uses"] for step in steps if "uses" in step]
    assert len(pinned) == 3, pinned
    assert all(re.fullmatch(r"actions/[a-z-]+@[0-9a-f]{40}", name) for name in pinned), pinned
    assert not [step for step in steps if "${{" in step.get("run", "")], "a script takes a text"
    assert os.path.basename(WORKFLOW_FILE) == "rigs.yaml"
