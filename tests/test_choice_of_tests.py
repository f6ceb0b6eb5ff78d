"""Which tests run with a change: those that it can reach, and none by a name that is gone."""

from pathlib import Path

import pytest
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
