"""Which tests run with a change: those that it can reach, and none by a name that is gone."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from deadline import FIRST, turn
from reach import ROOT, changed_files, reached

TESTS = {file.name: file for file in (ROOT / "tests").rglob("test_*.py")}


@pytest.mark.parametrize(
    ("changed", "reaches", "leaves"),
    [
        ("plants/telerobot/model.py", "test_telerobot.py", "test_worst.py"),
        ("plants/friction_arm/rigs/friction-a.yaml", "test_friction_arm_rigs.py", "test_worst.py"),
        ("executive/laws/references.py", "test_run.py", ""),
        ("executive/loop/supervisor.py", "test_supervisor_model.py", "test_claim.py"),
        ("tools/study/sweep/worst.py", "test_worst.py", "test_supervisor_model.py"),
        ("tools/live/scope.py", "test_scope.py", "test_worst.py"),
        ("tests/copies.py", "test_worst.py", ""),
        ("docs/margin.md", "test_pages.py", "test_worst.py"),
        ("pyproject.toml", "test_installing.py", ""),
    ],
)
def test_a_change_reaches_what_uses_it(changed: str, reaches: str, leaves: str) -> None:
    file = {ROOT / changed}
    assert (ROOT / changed).is_file() and reached(TESTS[reaches], file)
    assert not leaves or not reached(TESTS[leaves], file)


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a repository: what git exported")
def test_what_git_does_not_know_yet_is_a_change() -> None:
    new = ROOT / "tests/not_known_yet.txt"
    try:
        new.touch()
        assert new in changed_files("HEAD")
    finally:
        new.unlink()


def test_each_cost_is_that_of_a_test_that_is_there() -> None:
    """One that was renamed would run with every change, however long it takes."""
    rows = Path(__file__).with_name("seconds.csv").read_text().splitlines()
    assert rows[0] == "test,seconds,cases" and rows[1].startswith("all,"), rows[:2]
    gone = []
    for row in rows[2:]:
        file, _, function = row.rsplit(",", 2)[0].partition("::")
        name = function.rpartition("::")[2] if "::" in function else function
        text = TESTS[file].read_text() if file in TESTS else ""
        if f"def {name}(" not in text and f"{function.partition('::')[0]} =" not in text:
            gone.append(row)
    assert gone == []


def test_the_proofs_come_first_and_the_others_have_their_turn() -> None:
    files = [file.relative_to(ROOT).as_posix() for file in TESTS.values()]
    days = [sorted(files, key=lambda file: turn(file, f"2026-12-{day:02}")) for day in range(1, 31)]
    for order in days:
        number = sum(file.startswith(FIRST) for file in files)
        assert all(file.startswith(FIRST) for file in order[:number]) and 20 < number < len(files)
        assert order[0].startswith(FIRST[0])
    first_half = [set(order[: len(files) // 2]) for order in days]
    assert set().union(*first_half) == set(files) and first_half[0] != first_half[1]


def test_behind_its_minutes_no_test_begins_and_that_is_told(tmp_path: Path) -> None:
    (tmp_path / "test_two.py").write_text("def test_a(): pass\ndef test_b(): pass\n")
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-c", "/dev/null",
               "--confcutdir", str(ROOT / "tests"), "-p", "deadline"]  # fmt: skip
    for minutes, words in (("0", "NOT RUN: 2 tests of 1 files, as 0 minutes"), ("9", "2 passed")):
        for workers in ("0", "2"):
            told = subprocess.run(
                [*command, "-n", workers, "--minutes", minutes, str(tmp_path)],
                env=os.environ | {"PYTHONPATH": str(ROOT / "tests")},
                capture_output=True, text=True, check=False,
            ).stdout  # fmt: skip
            assert words in told, told
