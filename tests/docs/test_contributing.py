"""The six worked changes of CONTRIBUTING.md: each is carried out on a copy of the repository."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from blocks import KNOWN, ROOT, Reader, blocks_of

pytestmark = pytest.mark.deep

PAGE = ROOT / "CONTRIBUTING.md"
TITLES = ("A law", "A plant", "A kind of fault", "An alarm", "A part of a node", "A command")
PARTS = (
    "drivers", "executive", "plants", "tools", "pcpc", "tests", "docs", "pyproject.toml",
    "mkdocs.yml", "README.md",
)  # fmt: skip
NOT = ("__pycache__", ".mypy_cache", "earlier_logs", "golden", "runs")


def copied(folder: Path) -> Path:
    """Copy what a change touches, and what its tests need."""
    for part in PARTS:
        if (ROOT / part).is_file():
            shutil.copy(ROOT / part, folder)
        else:
            leave = shutil.ignore_patterns(*NOT)
            shutil.copytree(ROOT / part, folder / part, symlinks=True, ignore=leave)
    return folder


@pytest.mark.parametrize("title", TITLES)
def test_a_worked_change_works(title: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy = copied(tmp_path)
    monkeypatch.chdir(copy)
    monkeypatch.setenv("PYTHONPATH", str(copy))  # before the installed package
    text = PAGE.read_text("utf-8")
    begin = text[: text.index(f"\n## {title}\n")].count("\n")
    lines = text.split(f"\n## {title}\n")[1].split("\n## ")[0].count("\n")
    blocks = [b for b in blocks_of(PAGE) if 0 < int(b.where.split(":")[1]) - begin <= lines + 2]
    assert len(blocks) > 3, title
    reader = Reader(copy)
    for block in blocks:
        reader.follow(block)
    for words in (["check"], ["format", "--check"]):
        subprocess.run([sys.executable, "-m", "ruff", *words, "."], cwd=copy, check=True)


def test_every_block_is_carried_out() -> None:
    blocks = blocks_of(PAGE)
    assert {block.language for block in blocks} <= KNOWN
    assert [block.language for block in blocks].count("text") == 2, "how to begin, entry points"
    assert not [block.where for block in blocks if block.reason is not None]
    assert [line[3:] for line in PAGE.read_text("utf-8").split("\n") if line[:3] == "## "] == [
        *TITLES, "A package of your own",  # which tests/outside builds and uses
    ]  # fmt: skip
