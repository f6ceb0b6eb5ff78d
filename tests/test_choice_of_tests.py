"""Which tests run with a change: those that it can reach, and none by a name that is gone."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from deadline import FIRST, turn
from reach import ROOT, changed_files, is_left_out, marks_of_all, reached

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


def test_the_marks_of_all_tests_of_a_file_are_those_that_python_reads() -> None:
    """A wrong one leaves out a file; so does a folder's name that is no mark of it."""
    found = 0
    for file in TESTS.values():
        text = file.read_text()
        said = {
            node.attr
            for line in (ast.parse(text).body if "pytestmark" in text else [])
            if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "pytestmark"
            for node in ast.walk(line.value)
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "pytest.mark"
        }
        assert marks_of_all(text) == (set() if "mark.quick" in text else said), file
        assert file.parent.name not in ("browser", "quiet", "vcan") or file.parent.name in said, (
            file
        )
        found += "deep" in said
    assert found > 20
    deep = "pytestmark = pytest.mark.deep\n"
    assert marks_of_all(deep) == {"deep"} and not marks_of_all(f"{deep}@pytest.mark.quick\n")


@pytest.mark.parametrize(
    ("deep", "marks", "left"),
    [
        ("no", "", {"slow/test_deep.py"}),
        ("no", "not slow", {"slow", "slow/test_deep.py"}),
        ("only", "not slow", {"slow"}),
        ("too", "slow", set[str]()),
    ],
)
def test_what_no_test_is_wanted_of_is_left_out(
    tmp_path: Path, deep: str, marks: str, left: set[str]
) -> None:
    _write_two(tmp_path / "slow")
    names = ("slow", "slow/test_deep.py", "slow/test_plain.py")
    assert {name for name in names if is_left_out(tmp_path / name, deep, marks)} == left


def test_a_file_of_deep_tests_is_not_imported_where_they_are_left_out(tmp_path: Path) -> None:
    _write_two(tmp_path / "some")
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "conftest",
               "-c", "/dev/null", "--rootdir", ".", "--deep", "no"]  # fmt: skip
    done = subprocess.run(
        command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT / "tests")},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "1 passed" in done.stdout and "deselected" not in done.stdout, done


def _write_two(folder: Path) -> None:
    """Write a file of a deep test, which cannot be imported, and one of a plain test."""
    folder.mkdir()
    for name, begin in (("deep", "raise SystemError"), ("plain", "")):
        mark = f"import pytest\npytestmark = pytest.mark.{name}\n"
        (folder / f"test_{name}.py").write_text(f"{mark}{begin}\ndef test_it(): pass\n")


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
