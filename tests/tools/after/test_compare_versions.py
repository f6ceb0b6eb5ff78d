"""`pcpc compare --against`: the rigs of two versions of a real git repository."""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from json_schemas import holds
from logcommand import Done, run_here
from processes import ROOT, Running, alive, until

from pcpc.tools.after.compare.inputs import Tree
from pcpc.tools.after.compare.repository import Repository
from pcpc.tools.after.compare.versions import python_path

AUTHOR = ("-c", "user.name=engineer", "-c", "user.email=engineer@example.org")
SOFT = "  soft: {like: proportional, parameters: {gain: 2.0}}\n\nsupervisor:"
MOTOR, CALM = "motor/rig.yaml", "motor/calm.yaml"


def git(folder: Path, *words: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(folder), *AUTHOR, *words], check=True, capture_output=True, text=True
    )
    return done.stdout


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert text.count(old) == 1, f"{file}: {old!r} {text.count(old)} times"
    file.write_text(text.replace(old, new))


def copied(folder: Path) -> Path:
    """Return a repository with a user's rigs: motor, with two controllers, and calm, like it."""
    (folder / "motor").mkdir(parents=True)
    for file in (ROOT / "plants/probe").iterdir():
        if file.is_file():
            shutil.copy(file, folder / "motor")
    rig = folder / MOTOR
    edit(rig, "rig: probe", "rig: motor")
    edit(rig, "duration_s: 10.0", "duration_s: 0.05")
    edit(rig, "\nsupervisor:", SOFT)
    gain = "controllers: {proportional: {parameters: {gain: 3.0}}}\n"
    (folder / CALM).write_text(f"base: rig.yaml\nrig: calm\n{gain}")
    git(folder, "init", "-q")
    git(folder, "add", ".")
    git(folder, "commit", "-q", "-m", "one")
    return folder


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return one repository for all tests, so that its laws are compiled once."""
    return copied(tmp_path_factory.mktemp("versions") / "repo")


@pytest.fixture
def repo(shared: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder: the repository as it was committed."""
    git(shared, "checkout", "-q", "--", ".")
    git(shared, "clean", "-q", "-f", "-d")
    monkeypatch.chdir(shared)
    return shared


def compared(*words: str, code: int, against: str = "HEAD") -> Done:
    done = run_here("compare", "--against", against, *words, "--quiet")
    assert done.code == code, done
    return done


def pairs(*words: str, code: int) -> dict[str, Any]:
    told = holds("compare", compared(*words, "--json", "-", code=code).out)
    return {f"{pair['rig']}/{pair['controller']}".rstrip("/"): pair for pair in told["pairs"]}


def states(*words: str, code: int) -> dict[str, str]:
    return {name: pair["state"] for name, pair in pairs(*words, code=code).items()}


def left(repo: Path) -> list[Path]:
    """Return what lies of a repository where versions are written out."""
    base = Path(tempfile.gettempdir(), f"pcpc-{os.geteuid()}", "compare")
    return [path for path in base.glob(f"*-{Repository(repo).mark}*") if path.is_dir()]


def test_a_changed_gain_names_rig_metrics_and_first_cycle_and_runs_nothing_else(repo: Path) -> None:
    edit(repo / MOTOR, "gain: 4.0", "gain: 4.5")
    found = pairs(code=1)
    assert {name: pair["state"] for name, pair in found.items()} == {
        "calm/proportional": "unchanged",
        "motor/proportional": "changed",
    }
    motor = found["motor/proportional"]
    assert motor["first"]["name"] == "controller.command" and motor["first"]["cycle"] == 0
    gain = "controllers.proportional.parameters.gain"
    assert motor["settings"] == [{"name": gain, "old": 4.0, "new": 4.5}]
    assert motor["old"] == motor["new"] == "", "its logs are gone"
    assert not left(repo)
    status = git(repo, "status", "--short", "--", ":!*__pycache__*")
    assert status == f" M {MOTOR}\n", "nothing else changed"
    assert git(repo, "worktree", "list").count("\n") == 1 and not git(repo, "stash", "list")


def test_what_no_bit_depends_on_is_not_run(repo: Path) -> None:
    edit(repo / MOTOR, "rig: motor", "# a comment\nrig: motor")
    (repo / "README.md").write_text("words\n")
    (repo / "tests").mkdir()
    (repo / "tests/test_motor.py").write_text("\n")
    told = compared(code=0).out
    assert "working tree: 2 unchanged" in told and "calm (proportional), motor" in told, told


def test_another_controllers_gain_runs_that_controller(repo: Path) -> None:
    edit(repo / MOTOR, "gain: 2.0", "gain: 2.5")
    edit(repo / CALM, "controllers: {", "controllers: {soft: {parameters: {gain: 1.0}}, ")
    git(repo, "add", CALM)
    found = states("motor", code=1)
    assert found == {"motor/proportional": "unchanged", "motor/soft": "changed"}
    assert states("motor", "--controller", "proportional", code=0) == {
        "motor/proportional": "unchanged"
    }
    assert states("motor", "--all-controllers", code=1) == found
    refused = pairs("motor", "--controller", "sofft", code=1)["motor/sofft"]
    assert refused["said"] == ["no such controller; did you mean soft?"]


def test_a_changed_law_is_run_in_both_versions(repo: Path) -> None:
    edit(repo / "motor/law.py", "p.gain * (p.target", "1.5 * p.gain * (p.target")
    edit(repo / CALM, "gain: 3.0", "gain: oops")
    found = pairs(code=1)
    motor = found["motor/proportional"]
    assert motor["state"] == "changed" and motor["settings"] == []
    first = motor["first"]
    assert float(first["b"]) == 1.5 * float(first["a"]), first
    assert found["calm/proportional"]["state"] == "failed"
    (said,) = found["calm/proportional"]["said"]
    assert re.match(r"new: motor/calm\.yaml:3:\d+: .*gain.*oops", said), said


def test_rigs_of_one_version_and_unreadable_ones_are_named_and_the_others_compared(
    repo: Path,
) -> None:
    (repo / "motor/new.yaml").write_text("base: rig.yaml\nrig: new\n")
    (repo / CALM).write_text("rig: calm\n  base: rig.yaml\n")
    found = pairs(code=1)
    assert found["new"]["state"] == "alone"
    assert found["new"]["said"] == ["only in the new version: motor/new.yaml"]
    assert found["calm"]["state"] == "failed"
    assert found["calm"]["said"][0].startswith("new: motor/calm.yaml:2:"), found["calm"]
    assert found["motor/proportional"]["state"] == "unchanged"
    os.remove(repo / MOTOR)
    assert states("motor", code=1) == {"motor": "alone"}
    told = compared("motor", code=1).out
    assert "motor: only in the old version: motor/rig.yaml" in told, told


@pytest.mark.parametrize(
    ("folder", "word"),
    [
        ("motor", "."), ("motor", "rig.yaml"), ("motor", "motor"), ("", "motor"), ("", "motor/"),
        ("..", "repo/motor"), ("..", "repo/motor/rig.yaml"), ("/", "{repo}/motor"),
        ("../link", "."), ("..", "link/rig.yaml"),
    ],
)  # fmt: skip
def test_a_rig_is_named_as_for_every_other_command(
    folder: str, word: str, repo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = repo.parent / "link"
    link.unlink(missing_ok=True)
    link.symlink_to("repo/motor")
    monkeypatch.chdir(os.path.join(repo, folder))
    assert states(word.format(repo=repo), code=0) == {"motor/proportional": "unchanged"}


def test_a_rig_whose_folder_is_the_repository_is_the_dot_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cart = copied(tmp_path / "cart")
    for file in (cart / "motor").iterdir():
        file.rename(cart / file.name)
    git(cart, "add", "-A")
    git(cart, "commit", "-q", "-m", "two")
    monkeypatch.chdir(cart)
    assert states(".", code=0) == {"motor/proportional": "unchanged"}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path))
    assert states("cart", code=0) == {"motor/proportional": "unchanged"}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--against", "HEAD", ""), "'': no rig of either version"),
        (("--against", "nosuch"), "--against nosuch: git: Needed a single revision; `git log`"),
        (("--against", "HEAD", "mtor"), "mtor: no rig of either version; did you mean motor?"),
        (("--against", "HEAD", "--jobs", "0"), "--jobs 0: expected 1 or more"),
    ],
)
def test_wrong_input_is_a_line(words: tuple[str, ...], said: str, repo: Path) -> None:
    done = run_here("compare", *words, "--quiet")
    assert done.code == 2 and said in done.err and done.err.count("\n") == 1, done


def test_without_repository_git_or_rigs_a_line_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    done = compared(code=2)
    assert ": not in a git repository" in done.err and done.err.count("\n") == 1, done
    git(tmp_path, "init", "-q")
    (tmp_path / "other.yaml").write_text("rig: of another tool\n")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "one")
    (tmp_path / "other.yaml").unlink()
    assert "nothing to compare" in compared(code=1).out
    git(tmp_path, "commit", "-q", "-a", "-m", "two")
    assert "no rig, a YAML file with `rig: NAME`, in either version" in compared(code=2).err
    monkeypatch.setenv("PATH", str(tmp_path))
    assert compared(code=4).err.startswith("git: no such program; install it")


# The folder of the other version


def test_the_other_version_is_written_out_whole_and_removed_after_any_end(repo: Path) -> None:
    os.symlink("rig.yaml", repo / "motor/link.yaml")
    git(repo, "add", ".")
    commit = git(repo, "stash", "create").strip()
    git(repo, "reset", "-q", "--hard")
    here = Repository.around()
    with pytest.raises(KeyboardInterrupt), here.checked_out(commit) as folder:
        tree = folder / "tree"
        assert sorted(here.files_of(commit)) == sorted(
            path.relative_to(tree).as_posix() for path in tree.rglob("*") if not path.is_dir()
        )
        assert (tree / "motor/link.yaml").is_symlink()
        with here.checked_out(commit) as second:
            assert second != folder and (second / "tree" / MOTOR).is_file()
        raise KeyboardInterrupt
    assert not folder.exists() and not second.exists()


def test_a_folder_of_a_killed_one_goes_with_the_next_start(repo: Path) -> None:
    code = (
        "import signal\nfrom pcpc.tools.after.compare.repository import Repository\n"
        "here = Repository.around()\n"
        "with here.checked_out(here.commit('HEAD')) as folder:\n"
        "    print(folder, flush=True)\n    signal.pause()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=repo
    )
    assert process.stdout is not None
    folder = Path(process.stdout.readline().strip())
    here = Repository.around()
    with here.checked_out(here.commit("HEAD")) as other:
        assert folder.is_dir() and other != folder, "it is in use"
    process.kill()
    process.wait()
    assert folder.is_dir()
    with here.checked_out(here.commit("HEAD")) as again:
        assert again == folder, "compiled code is found again"
    assert not folder.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_ended_early_it_leaves_no_process_and_no_folder(number: int, repo: Path) -> None:
    edit(repo / MOTOR, "gain: 4.0", "gain: 4.75")
    edit(repo / MOTOR, "duration_s: 0.05", "duration_s: 100000.0")
    with Running("compare", "--against", "HEAD", "motor", cwd=repo) as command:

        def runs() -> list[int]:
            """Return the processes that run the new version."""
            return [pid for pid in descendants(command.process.pid) if "simulate" in words(pid)]

        until(lambda: any(str(repo) == cwd(pid) for pid in runs()) or command.over(), "it runs")
        family = descendants(command.process.pid)
        (folder,) = left(repo)
        os.kill(command.process.pid, number)
        done = command.done()
        until(lambda: not any(map(alive, family)), f"{family} end")
    if number == signal.SIGKILL:
        with Repository.around().checked_out("HEAD"):
            pass
    else:
        assert done.code == 130, done
    assert not folder.exists()


def words(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode().replace("\0", " ")
    except OSError:
        return ""


def cwd(pid: int) -> str:
    try:
        return os.readlink(f"/proc/{pid}/cwd")
    except OSError:
        return ""


def descendants(pid: int) -> list[int]:
    """Return the processes below one."""
    found, parents = [], {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    todo = [pid]
    while todo:
        above = todo.pop()
        below = [child for child, parent in parents.items() if parent == above]
        found += below
        todo += below
    return found


# What goes into a run


@pytest.mark.parametrize(
    ("file", "old", "new", "same"),
    [
        (MOTOR, "# a stall", "# one", True),
        (MOTOR, "gain: 2.0", "gain: 2.5", True),
        (MOTOR, "gain: 4.0", "gain: 4.5", False),
        ("motor/probe.dbc", "VERSION", "VERSION ", False),
        ("motor/model.py", '"""', '"""A', False),
        ("motor/inner.py", "1.0", "2.0", False),
        ("motor/unused.py", "1.0", "2.0", True),
        ("motor/table.csv", "1.0", "2.0", False),
        ("notes.md", "1.0", "2.0", True),
        ("tests/test_motor.py", "1.0", "2.0", True),
    ],
)
def test_inputs_are_the_values_and_files_of_the_controller_that_runs(
    file: str, old: str, new: str, same: bool, tmp_path: Path
) -> None:
    sides = []
    for side in ("old", "new"):
        root = copied(tmp_path / side)
        (root / "lib").symlink_to("motor")
        edit(root / MOTOR, "dbc: probe.dbc", "dbc: ../lib/probe.dbc")
        (root / "tests").mkdir()
        for name in ("motor/unused.py", "motor/table.csv", "notes.md", "tests/test_motor.py"):
            (root / name).write_text("K = 1.0\n")
        (root / "motor/inner.py").write_text("K = 1.0\n")
        (root / "motor/outer.py").write_text("try:\n    from inner import K\nfinally:\n    pass\n")
        law = root / "motor/law.py"
        law.write_text(law.read_text() + "\nimport outer  # noqa: E402\n")
        if side == "new":
            text = (root / file).read_text()
            assert old in text, text
            (root / file).write_text(text.replace(old, new, 1))
        sides.append(Tree(root, Repository(root).files()))
    digests = []
    for tree in sides:
        rig = tree.rig(MOTOR)
        assert rig is not None
        changed = [] if file == "motor/unused.py" else [file]
        used = tree.used(rig)
        assert used >= {MOTOR, *(f"motor/{n}" for n in ("probe.dbc", "law.py", "inner.py"))}
        loose = tree.loose(changed, used)
        digests.append(tree.digest(rig, "proportional", loose))
    assert (digests[0] == digests[1]) is same


# pcpc's own repository


def test_each_version_runs_with_its_own_code_where_the_repository_is_pcpcs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "pcpc"
    without = shutil.ignore_patterns("__pycache__", "figures")
    for folder in ("drivers", "executive", "plants", "tools", "pcpc"):
        shutil.copytree(ROOT / folder, root / folder, symlinks=True, ignore=without)
    git(root, "init", "-q")
    git(root, "add", ".")
    git(root, "commit", "-q", "-m", "one")
    monkeypatch.chdir(root)
    code = "metrics = guarded(lambda: self.evaluation.figures(judged))"
    git(root, "branch", "-q", "now")
    git(root, "checkout", "-q", "--orphan", "before")
    git(root, "rm", "-q", "--cached", "-r", "pcpc")
    git(root, "commit", "-q", "-m", "before")
    git(root, "checkout", "-q", "-f", "now")
    assert "before: that version of pcpc cannot run" in compared(against="before", code=2).err
    edit(root / "tools/after/verdict/judge.py", code, "metrics = {'answer': 42.0}")
    pair = pairs("probe", code=1)["probe/proportional"]
    assert pair["first"] is None and pair["settings"] == []
    assert [m for m in pair["metrics"] if m["old"] != m["new"]] == [
        {"name": "answer", "old": None, "new": 42.0}
    ]


def test_what_is_installed_from_the_working_tree_comes_from_the_other_version(
    repo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for root in (repo, tmp_path):
        (root / "src").mkdir(exist_ok=True)
    monkeypatch.setattr(sys, "path", [str(repo / "src"), str(repo / "absent"), "/usr/lib"])
    monkeypatch.delenv("PYTHONPATH", raising=False)
    trees = (Tree(tmp_path, []), Tree(repo, []))
    assert [python_path(tree, trees[1]) for tree in trees] == [
        str(tmp_path / "src"),
        str(repo / "src"),
    ]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(repo / "lib"), "/opt/lib")))
    assert python_path(trees[0], trees[1]) == f"{tmp_path / 'src'}{os.pathsep}/opt/lib"
