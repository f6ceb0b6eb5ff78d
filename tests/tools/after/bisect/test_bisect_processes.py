"""`pcpc bisect` as it is used: each run a process of its own, in a user's repository and pcpc's."""

import os
import shutil
import signal
import tempfile
from pathlib import Path

import pytest
from bisected import RIG, TAU, ULP_MORE, begun, commit, edit, git, note, state
from json_schemas import holds
from logcommand import run_here
from processes import ROOT, Running, alive, until

from pcpc.tools.after.compare.repository import Repository

pytestmark = pytest.mark.deep


def left(repo: Path) -> list[Path]:
    """Return what lies of a repository where versions are written out."""
    base = Path(tempfile.gettempdir(), f"pcpc-{os.geteuid()}", "compare")
    return [*base.glob(f"*-{Repository(repo).mark}*")]


def test_one_ulp_in_thirty_commits_is_found_and_nothing_is_left(tmp_path: Path) -> None:
    repo = begun(tmp_path / "a rig")
    for number in range(29):
        if number == 21:
            edit(repo / RIG, TAU, ULP_MORE)
            planted = commit(repo, "planted")
        else:
            note(repo, number)
    (repo / "motor/law.py").write_text("not committed\n")
    before = state(repo)
    done = run_here("bisect", repo / "motor", "good", "HEAD", "--quiet", "--json")
    found = holds("bisect", done.out)
    assert [one["commit"] for one in found["suspects"]] == [planted]
    assert found["runs"] in (8, 9)
    assert (found["nodes"][0]["ulp"], found["uncommitted"]) == (1, 1)
    assert state(repo) == before and not left(repo)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_ended_early_it_leaves_no_process_and_no_folder(number: int, tmp_path: Path) -> None:
    repo = begun(tmp_path / "repo")
    note(repo, 1)
    before = state(repo)
    with Running("bisect", "motor", "good", "HEAD", "--duration", "28h", cwd=repo) as command:

        def logs() -> list[Path]:
            return [log for one in left(repo) for log in one.glob("run/it/log.mcap")]

        until(lambda: any(log.stat().st_size for log in logs()) or command.over(), "it runs")
        (child,) = [
            int(path.parent.name)
            for path in Path("/proc").glob("[0-9]*/cwd")
            if _target(path).startswith(str(left(repo)[0].with_suffix("")))
        ]
        os.kill(command.process.pid, number)
        done = command.done()
        until(lambda: not alive(child), "the run ends")
    if number == signal.SIGKILL:
        with Repository(repo).checked_out("HEAD"):
            pass
    else:
        assert done.code == 130, done
    assert not left(repo) and state(repo) == before


def _target(link: Path) -> str:
    try:
        return os.readlink(link)
    except OSError:
        return ""


def test_in_pcpcs_own_repository_its_code_comes_from_the_commit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "pcpc"
    without = shutil.ignore_patterns("__pycache__", "figures", "shipped")
    for folder in ("drivers", "executive", "plants", "tools", "pcpc"):
        shutil.copytree(ROOT / folder, root / folder, symlinks=True, ignore=without)
    git(root, "init", "-q")
    commit(root, "one")
    git(root, "tag", "good")
    (root / "README.md").write_text("words\n")
    commit(root, "words")
    edit(root / "plants/probe/model.py", "dt / p.tau_s", "1.0000000000000002 * dt / p.tau_s")
    planted = commit(root, "planted")
    git(root, "rm", "-q", "-r", "--cached", "pcpc")
    git(root, "commit", "-q", "-m", "no pcpc")
    commit(root, "again")
    monkeypatch.setenv("PYTHONPATH", str(root))
    words = "--duration", "10ms", "--quiet", "--json"
    done = run_here("bisect", root / "plants/probe", "good", "HEAD~2", *words)
    found = holds("bisect", done.out)
    assert [one["commit"] for one in found["suspects"]] == [planted], done
    assert found["files"] == ["plants/probe/model.py"] and found["nodes"][0]["name"] == "lag.x"
    done = run_here("bisect", root / "plants/probe", planted, "HEAD", *words)
    assert done.code == 1 and holds("bisect", done.out)["suspects"] == [], done
    done = run_here("bisect", root / "plants/probe", "HEAD~", "HEAD", *words)
    assert "cannot be run: it has no pcpc that can run a rig" in done.err, done
