"""Folders that commands make by themselves: each its own, also of commands that start at once."""

import threading
from pathlib import Path

import pytest

from pcpc.executive.errors import RigError
from pcpc.tools.start.folder import folder_of, fresh

AT_ONCE = 12


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_commands_that_start_in_the_same_instant_get_a_folder_each() -> None:
    made: list[Path] = []
    together = threading.Barrier(AT_ONCE)

    def start() -> None:
        together.wait()
        made.append(fresh("sweep-hull"))

    threads = [threading.Thread(target=start) for _ in range(AT_ONCE)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(made)) == AT_ONCE, made
    assert sorted(Path("runs").iterdir()) == sorted(made)


def test_a_folder_of_which_nothing_came_is_gone_and_a_named_one_is_the_users() -> None:
    with folder_of(None, "fit-hull") as own:
        assert own.is_dir()
    assert not Path("runs").exists(), "it was made for this folder"
    with folder_of(None, "fit-hull") as kept:
        (kept / "fit.yaml").touch()
    Path("mine").mkdir()
    with folder_of("mine", "fit-hull"):
        pass
    with folder_of("a/new/one", "fit-hull") as named:
        assert named.is_dir()
    assert not Path("a").exists()
    assert (own.exists(), kept.exists(), Path("mine").is_dir()) == (own == kept, True, True)


def test_a_folder_without_a_name_is_refused() -> None:
    with pytest.raises(RigError, match="-o '': expected a folder"), folder_of("", "fit-hull"):
        pass
    assert not list(Path().iterdir())


def test_runs_that_is_no_folder_is_said() -> None:
    Path("runs").touch()
    with pytest.raises(RigError, match="choose another folder with -o"):
        fresh("sweep-hull")
    with pytest.raises(RigError, match="choose another folder with -o"), folder_of("runs/x", ""):
        pass
