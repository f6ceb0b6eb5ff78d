"""docs/tool-confidence.md: each test that it names is there and is run, and it claims no more."""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

from pcpc.tools.dev import confidence

PAGE = ROOT / "docs/tool-confidence.md"
ROWS = confidence.rows()
NOT_RUN = re.compile(r"\b(skip|skipif|xfail|importorskip|vcan|quiet|browser)\b")


def why_not(test: str) -> str:
    """Return why a test shows nothing: it is not there, or not run by `make test-all`; or ""."""
    file, _, name = test.partition("::")
    path = ROOT / "tests" / file
    if not path.is_file():
        return "no such file"
    tree = ast.parse(path.read_text("utf-8"))
    found = [one for one in tree.body if isinstance(one, ast.FunctionDef) and one.name == name]
    if len(found) != 1 or not name.startswith("test_"):
        return "no such test"
    marks = [one for one in tree.body if isinstance(one, ast.Assign)
             and ast.unparse(one.targets[0]) == "pytestmark"]  # fmt: skip
    calls = [one for one in ast.walk(found[0]) if isinstance(one, ast.Call)]
    texts = [ast.unparse(one) for one in (*found[0].decorator_list, *marks)]
    texts += [text for one in calls if (text := ast.unparse(one.func)).startswith("pytest.")]
    return next((f"marked: {text}" for text in texts if NOT_RUN.search(text)), "")


@pytest.mark.parametrize("test", sorted({test for row in ROWS for test in row.shown}))
def test_each_test_that_is_named_is_there_and_is_run(test: str) -> None:
    assert why_not(test) == ""


def test_a_test_that_shows_nothing_is_found(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests/test_a.py").write_text(
        "@pytest.mark.skipif(True, reason='')\ndef test_skipped():\n    pass\n\n\n"
        "def test_left():\n    pytest.skip('no')\n\n\ndef test_good():\n    pass\n"
    )
    (tmp_path / "tests/test_b.py").write_text("pytestmark = pytest.mark.vcan\ndef test_c(): pass\n")
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    wrong = {"test_a.py::test_skipped", "test_a.py::test_left", "test_b.py::test_c", "test_c.py::x",
             "test_a.py::test_gone", "test_a.py"}  # fmt: skip
    assert {one for one in (*wrong, "test_a.py::test_good") if why_not(one)} == wrong


@pytest.mark.deep
def test_pytest_collects_each_of_them() -> None:
    named = {test for row in ROWS for test in row.shown}
    files = sorted({f"tests/{test.partition('::')[0]}" for test in named})
    words = [sys.executable, "-m", "pytest", "--collect-only", "--deep", "too", *files]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    found = {line.partition("[")[0].removeprefix("tests/") for line in done.stdout.splitlines()}
    assert named <= found, (named - found, done.stdout[-500:], done.stderr)


def test_the_page_is_written_and_claims_no_qualification() -> None:
    text = PAGE.read_text("utf-8")
    assert text == confidence.written(), "run `make reference`"
    assert "pcpc is **not qualified**" in text
    assert not re.search(r"(?<!not )\bqualified\b|certified|compliant", text.replace("*", ""))


def test_the_level_follows_from_the_detection_and_no_row_is_without_a_test() -> None:
    for row in ROWS:
        assert row.shown and row.td in (1, 2, 3) and row.tcl == row.td, row
    assert {row.td for row in ROWS} == {1, 2, 3}, "what nothing detects has its row"
    assert PAGE.read_text("utf-8").count("\n| ") == len(ROWS) + 1


def test_every_kind_of_fault_of_the_evidence_is_in_one_row() -> None:
    faults = json.loads(confidence.NUMBERS.read_text("utf-8"))["matrix"]["rows"]
    counted = [re.match(r"(\d+) faults of bus", row.malfunction) for row in ROWS]
    assert sum(int(one[1]) for one in counted if one) == len({one["fault"] for one in faults})
    never = {one["fault"] for one in faults} - {one["fault"] for one in faults if one["noticed"]}
    (low,) = [row for row in ROWS if row.td == 3]
    assert set(low.detected.removeprefix("nothing: ").split("; ")) == never
