"""The commit of a rig: what git says of its folder, and nothing where nobody can say it."""

import os
import subprocess
from pathlib import Path

import pytest

from pcpc.executive.log import provenance
from pcpc.executive.log.provenance import of_rig, rig_commits

AUTHOR = "-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "init.defaultBranch=main"


def git(folder: Path, *words: str) -> str:
    """Return what git says in a folder."""
    done = subprocess.run(
        ["git", "-C", str(folder), *AUTHOR, *words], check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Return a rig file in a folder of a repository of one commit, beside another folder."""
    for name in ("rigs/one/rig.yaml", "other/rig.yaml"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text("rig: one\n")
    (tmp_path / ".gitignore").write_text("kept/\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "one")
    return tmp_path / "rigs/one/rig.yaml"


def told(rig: Path) -> str:
    return of_rig(rig).get("rig_git", "none")


def test_it_is_the_commit_of_the_work_tree(rig: Path) -> None:
    commit = git(rig.parent, "rev-parse", "--short=12", "HEAD")
    assert told(rig) == commit
    (rig.parents[2] / "link.yaml").symlink_to(rig)
    assert told(rig.parents[2] / "link.yaml") == commit, "a link is where it leads to"
    git(rig.parent, "checkout", "-q", "--detach")
    assert told(rig) == commit, "no branch"


@pytest.mark.parametrize(
    ("file", "dirty"),
    [
        ("rig.yaml", True), ("new.yaml", True), ("laws/mine.py", True), ("new file.csv", True),
        ("runs/1/log.mcap", False), ("report.html", False), ("../../other/rig.yaml", False),
        ("../../other/new.yaml", False),
    ],
)  # fmt: skip
def test_it_is_dirty_where_the_folder_of_the_rig_is(rig: Path, file: str, dirty: bool) -> None:
    path = rig.parent / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("changed\n")
    assert told(rig).endswith("-dirty") is dirty
    git(rig.parents[2], "add", "-A")
    assert told(rig).endswith("-dirty") is (dirty or file.startswith(("runs", "report")))
    git(rig.parents[2], "commit", "-qm", "two")
    assert told(rig) == git(rig.parent, "rev-parse", "--short=12", "HEAD")


def test_a_rig_that_was_removed_or_renamed_in_the_index_is_dirty(rig: Path) -> None:
    git(rig.parent, "mv", "rig.yaml", "? kept.yaml")
    assert told(rig.with_name("? kept.yaml")).endswith("-dirty")


def test_without_a_work_tree_no_process_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subprocess, "run", lambda *words, **more: pytest.fail("started"))
    assert told(tmp_path / "rig.yaml") == "none"


def test_where_nothing_is_known_nothing_is_said(
    rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept/rig.yaml").write_text("rig: one\n")
    assert told(tmp_path / "kept/rig.yaml") == "none", "ignored: of no commit"
    for folder, link in (("empty", None), ("broken", "gitdir: nowhere\n")):
        (tmp_path / folder).mkdir()
        if link is None:
            git(tmp_path / folder, "init", "-q")
        else:
            (tmp_path / folder / ".git").write_text(link)
        assert told(tmp_path / folder / "rig.yaml") == "none", folder
    with monkeypatch.context() as patch:
        patch.setenv("PATH", str(tmp_path))
        assert told(rig) == "none", "no git"
        slow = tmp_path / "git"
        slow.write_text("#!/bin/sh\nexec /bin/sleep 60\n")
        slow.chmod(0o755)
        patch.setattr(provenance, "_PATIENCE_S", 0.2)
        assert told(rig) == "none", "too slow"
        slow.write_text("#!/bin/sh\nprintf '# branch.oid \\033[2J\\0'\n")
        assert told(rig) == "none", "no hash"


def test_a_hook_of_another_repository_changes_nothing(
    rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commit = told(rig)
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "nowhere"))
    monkeypatch.setenv("GIT_WORK_TREE", os.fspath(tmp_path / "nowhere"))
    assert told(rig) == commit != "none"


def test_the_commit_of_pcpc_is_found_without_a_lock_of_its_checkout(
    rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provenance, "_PROJECT", tmp_path)
    commit, index = git(tmp_path, "rev-parse", "--short=12", "HEAD"), tmp_path / ".git/index"
    os.utime(rig, (1, 1))  # git would write its index anew
    before = index.read_bytes()
    assert provenance._git() == told(rig) == commit and index.read_bytes() == before
    (tmp_path / ".git/index.lock").touch()  # somebody commits
    rig.write_text("changed\n")
    assert provenance._git() == told(rig) == f"{commit}-dirty"
    (tmp_path / ".git/index.lock").unlink()
    git(tmp_path, "tag", "-am", "v1", "v1")
    git(tmp_path, "checkout", "-q", ".")
    (tmp_path / "new.py").touch()
    assert provenance._git() == "v1", "files that nobody has added are none of it"
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "nowhere"))  # of a hook
    assert provenance._git() == "v1"
    index.write_bytes(b"damaged")
    assert provenance._git() == "none", "whether it has changed is not known"


def test_nodes_that_differ_are_told_one_by_one() -> None:
    logs = {"executive": {"rig_git": "a"}, "plant": {"rig_git": "b-dirty"}, "local": {}}
    assert rig_commits(logs, logs) == "a (executive), b-dirty (plant)"
    assert rig_commits(logs, ("plant", "local")) == "b-dirty" and rig_commits(logs, ["local"]) == ""
