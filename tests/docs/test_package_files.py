"""What users of a package look for beside the code says the same as pyproject.toml."""

import json
import re
import subprocess
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml
from places import ROOT

from pcpc.tools.dev import release

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def test_the_citation_is_of_this_version() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(cited), "the format demands them"
    assert (cited["version"], cited["license"]) == (PROJECT["version"], PROJECT["license"])
    assert [one["name"] for one in cited["authors"]] == [one["name"] for one in PROJECT["authors"]]


def test_the_newest_entry_of_the_change_log_is_this_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text("utf-8")
    day = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))["date-released"]
    first = re.findall(r"^## (.*)$", text, re.MULTILINE)[0]
    assert first == f"{PROJECT['version']}, {day.day} {day:%B %Y}"


def test_the_package_is_typed_and_says_for_whom_it_is() -> None:
    assert (ROOT / "pcpc/py.typed").is_file() and "Typing :: Typed" in PROJECT["classifiers"]
    assert PROJECT["authors"] and PROJECT["keywords"]
    assert "*Report a vulnerability*" in (ROOT / "SECURITY.md").read_text("utf-8")


def test_a_hosted_runner_does_what_a_submission_has_to_pass() -> None:
    flow = yaml.safe_load((ROOT / ".github/workflows/tests.yaml").read_text("utf-8"))
    job = flow["jobs"]["tests"]
    assert [step["run"] for step in job["steps"] if "run" in step] == ["bash .ci/run"]
    assert set(flow[True]) == {"push", "pull_request"}, "YAML 1.1 reads `on` as true"
    python = next(step["with"] for step in job["steps"] if "python" in step.get("uses", ""))
    assert PROJECT["requires-python"] == f">={python['python-version']}"


def test_before_a_commit_runs_what_lint_runs() -> None:
    (repo,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text("utf-8"))["repos"]
    entries = [hook["entry"].replace(".venv/bin/", "") for hook in repo["hooks"]]
    makefile = (ROOT / "Makefile").read_text("utf-8")
    recipe = makefile.partition("\nlint:")[2].partition("\n\n")[0]
    lines = [line.strip().removesuffix(" .") for line in recipe.splitlines()[1:]]
    assert [f"$(BIN)/{entry}" for entry in entries] == lines


def test_who_changes_the_project_is_told_what_is_there() -> None:
    text = (ROOT / "AGENTS.md").read_text("utf-8")
    assert "](AGENTS.md)" in (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    assert len(text.splitlines()) <= 60 and max(map(len, text.splitlines())) <= 120
    names = set(re.findall(r"`([\w./-]+/[\w./-]*|[A-Z]+\.md)`|\]\(([^)]+)\)|bash (\S+)", text))
    paths = {name for found in names for name in found if name}
    assert len(paths) > 25 and [name for name in paths if not (ROOT / name).exists()] == []
    makefile = (ROOT / "Makefile").read_text("utf-8")
    for target in set(re.findall(r"make ([a-z-]+)", text)):
        assert re.search(rf"^([a-z -]+ )?{target}( [a-z -]+)?:", makefile, re.MULTILINE), target
    for heading in ("Which source wins", "What to read first", "What a change has to pass",
                    "What must never happen"):  # fmt: skip
        assert f"## {heading}\n" in text
    never = text.partition("## What must never happen")[2]
    assert all(word in never for word in ("loop's path", "loosened limit", "blessed golden"))


@pytest.mark.parametrize("name", ["fault", "wish"])
def test_who_opens_an_issue_is_asked_for_what_is_needed(name: str) -> None:
    form = yaml.safe_load((ROOT / f".github/ISSUE_TEMPLATE/{name}.yaml").read_text("utf-8"))
    assert form["name"] and form["description"], "the format demands them"
    needed = [one["id"] for one in form["body"] if one.get("validations", {}).get("required")]
    assert needed == {"fault": ["seen", "expected", "doctor"], "wish": ["task"]}[name]


def test_the_container_has_what_a_fresh_machine_is_given() -> None:
    docker = (ROOT / "Dockerfile").read_text("utf-8")
    given = (ROOT / ".ci/run").read_text("utf-8").partition("--no-install-recommends ")[2]
    for package in given.partition(" >")[0].split():
        assert f" {package}" in docker or package == "python3-venv", "the image has Python"
    assert "RUN make tools" in docker and 'CMD ["make", "run"]' in docker
    container = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text("utf-8"))
    file = ROOT / ".devcontainer" / container["build"]["dockerfile"]
    assert file.resolve() == ROOT / "Dockerfile"
    ignored = (ROOT / ".dockerignore").read_text("utf-8").split()
    assert {".venv", "runs"} <= set(ignored) and "tests" not in ignored


def test_where_there_is_no_docker_every_step_of_the_image_is_done() -> None:
    script = (ROOT / ".ci/container").read_text("utf-8")
    docker = (ROOT / "Dockerfile").read_text("utf-8").replace("\\\n", " ")
    steps = {line.split()[0] for line in docker.splitlines() if line and line[0] not in "# "}
    assert steps == {"FROM", "WORKDIR", "COPY", "RUN", "CMD"}
    assert "s/^FROM " in script and all(f"        {step}) " in script for step in steps - {"FROM"})
    subprocess.run(["bash", "-n", ROOT / ".ci/container"], check=True)


def test_what_git_does_not_have_is_not_released(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        own = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
        subprocess.run(["git", *own, *words], cwd=tmp_path, check=True, capture_output=True)

    git("init")
    (tmp_path / ".gitignore").write_text("build\ndist\n")
    git("add", ".")
    git("commit", "-m", "all")
    assert release.obstacles(tmp_path) == []
    (tmp_path / "new.py").touch()
    (tmp_path / "build/lib").mkdir(parents=True)
    (tmp_path / "dist").mkdir()
    (tmp_path / "dist/old.whl").touch()
    found = " ".join(release.obstacles(tmp_path))
    assert all(name in found for name in ("new.py", "build/lib", "old.whl")), found


def test_a_wheel_takes_the_code_of_other_machines_if_it_is_of_the_same_sources(
    tmp_path: Path,
) -> None:
    def wheel(*places: str) -> Path:
        made = tmp_path / "other.whl"
        with zipfile.ZipFile(made, "w") as content:
            content.writestr("pcpc/__init__.py", "")
            for place in places:
                content.writestr(f"{release.SHIPPED}/{place}", "code")
        return made

    own = Path("x86_64", "0a")
    release.add_code(wheel("aarch64/0a/loop/pass.nbc", "aarch64/0a/a.nbi"), own, tmp_path / "new")
    found = {path.name: path.read_text() for path in (tmp_path / "new").rglob("*.nb?")}
    assert found == {"pass.nbc": "code", "a.nbi": "code"}
    assert not (tmp_path / "new/pcpc/__init__.py").exists()
    for places, why in [
        ([], "brings no compiled code"),
        (["x86_64/0a/a.nbi"], "name another machine's"),
        (["aarch64/0a/a.nbi", "riscv64/0b/a.nbi"], "is of other sources"),
    ]:
        with pytest.raises(SystemExit, match=why):
            release.add_code(wheel(*places), own, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_a_release_does_in_its_workflow_what_is_tried_here(tmp_path: Path) -> None:
    text = (ROOT / ".github/workflows/release.yaml").read_text("utf-8")
    jobs = yaml.safe_load(text)["jobs"]
    order = [(name, job.get("needs")) for name, job in jobs.items()]
    assert order == [
        ("arm64", None), ("x86-64", "arm64"), ("arm64-again", "x86-64"), ("publish", "arm64-again")
    ]  # fmt: skip
    steps = {name: job["steps"] for name, job in jobs.items()}
    for step in [step for job in steps.values() for step in job]:
        assert re.fullmatch(r"[\w/.-]+@[0-9a-f]{40}", step.get("uses", f"a@{40 * '0'}")), step
    commands = {name: [step["run"] for step in job if "run" in step] for name, job in steps.items()}
    assert commands["arm64"] == ["make release"]
    assert commands["arm64-again"] == ['make release TRY="$(echo build/dist/*.whl)"']
    tag, made, notes, sums = commands["x86-64"]
    check, packed, _ = commands["publish"]
    assert made == 'make release WHEELS="$(echo build/arm64/*.whl)"'
    for file in ("pyproject.toml", "CHANGELOG.md"):
        (tmp_path / file).write_text((ROOT / file).read_text("utf-8"))
    (tmp_path / "dist").mkdir()
    names = [f"pcpc-{PROJECT['version']}{end}" for end in (".tar.gz", "-py3-none-any.whl")]
    for name in names:
        (tmp_path / "dist" / name).write_text(name)
    for version, code in ((PROJECT["version"], 0), ("9.9.9", 1)):
        done = subprocess.run(
            ["bash", "-c", tag], cwd=tmp_path, env={"GITHUB_REF_NAME": f"v{version}"}, check=False
        )
        assert done.returncode == code
    for words in (notes, sums, check, packed):
        subprocess.run(["bash", "-ec", words], cwd=tmp_path, check=True)
    told = (tmp_path / "dist/notes.md").read_text("utf-8")
    assert told.startswith(f"## {PROJECT['version']}, ") and told.count("\n## ") == 0
    assert sorted(file.name for file in (tmp_path / "packages").iterdir()) == sorted(names)
    (tmp_path / "dist" / names[0]).write_text("changed")
    assert subprocess.run(["bash", "-c", check], cwd=tmp_path, check=False).returncode == 1
