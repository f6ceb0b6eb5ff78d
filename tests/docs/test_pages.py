"""What a page says happens: its code blocks are carried out, in order, in an empty folder."""

import shutil
from pathlib import Path

import pytest
from blocks import KNOWN, PAGES, ROOT, SHOWN, Block, Reader, blocks_of

from pcpc.tools.make import new
from pcpc.tools.terminal import screen

BLOCKS = {page.relative_to(ROOT).as_posix(): blocks_of(page) for page in PAGES}
BOOK = "docs/book/"  # quotes laws: test_book.py
RUN = [
    name
    for name, blocks in BLOCKS.items()
    if any(block.language not in SHOWN for block in blocks) and not name.startswith(BOOK)
]
NOT_RUN = {  # blocks by page that nobody carries out, each with its reason above it
    "README.md": 7,
    "docs/device.md": 2,
    "docs/howto/bus.md": 2,
    "docs/howto/can-adapter.md": 3,
    "docs/howto/ci.md": 1,
    "docs/howto/drive.md": 4,
    "docs/howto/calibrate.md": 1,
    "docs/howto/firmware.md": 3,
    "docs/howto/fit.md": 2,
    "docs/howto/fmu.md": 1,
    "docs/howto/foxglove.md": 1,
    "docs/howto/generate.md": 4,
    "docs/margin.md": 4,
    "docs/howto/page.md": 1,
    "docs/howto/swarm.md": 2,
    "docs/howto/terminal.md": 1,
    "docs/tutorial.md": 1,
}

COMPILE = {"docs/howto/fmu.md"}  # pages with a block that needs a C compiler


@pytest.mark.deep
@pytest.mark.paced  # what a reader types keeps time, and a loaded machine may not
@pytest.mark.parametrize("page", RUN)
def test_every_block_does_what_the_page_says(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if page in COMPILE and shutil.which("gcc") is None:
        pytest.skip("no gcc here: apt install gcc")
    monkeypatch.chdir(tmp_path)
    reader = Reader(tmp_path)
    for block in BLOCKS[page]:
        reader.follow(block)
        monkeypatch.chdir(reader.folder)


def test_every_block_says_what_it_is() -> None:
    wrong = [b.where for blocks in BLOCKS.values() for b in blocks if b.language not in KNOWN]
    assert not wrong, f"a block is one of {sorted(KNOWN)}: {wrong}"
    fences = sum(page.read_text("utf-8").count("\n```") for page in PAGES)
    assert fences == 2 * sum(map(len, BLOCKS.values())), "a fence that is no block"


def test_what_is_not_run_is_known() -> None:
    marked = {n: sum(b.reason is not None for b in blocks) for n, blocks in BLOCKS.items()}
    assert {name: count for name, count in marked.items() if count} == NOT_RUN


def follow(folder: Path, *given: tuple[str, str]) -> None:
    reader = Reader(folder)
    for language, text in given:
        reader.follow(Block("page:1", language, text, None))


def test_a_block_that_does_otherwise_is_found(tmp_path: Path) -> None:
    (tmp_path / "law.py").write_text("a = 1\nb = 2\n")
    follow(tmp_path, ("sh", "echo 12 rows"), ("output", "... rows\n"), ("yaml", "# x.yaml\na: 1\n"))
    follow(tmp_path, ("diff", "--- law.py\n a = 1\n-b = 2\n+b = 3\n+c = 4\n"))
    assert (tmp_path / "law.py").read_text() == "a = 1\nb = 3\nc = 4\n"
    assert (tmp_path / "x.yaml").is_file()
    for wrong in (
        [("sh", "false | true")],
        [("sh", "echo 12 rows"), ("output", "13 rows\n")],
        [("python", "assert False")],
        [("diff", "--- law.py\n-b = 2\n+b = 3\n")],
    ):
        with pytest.raises(AssertionError):
            follow(tmp_path, *wrong)


def test_the_tutorial_lists_all_files_that_new_writes() -> None:
    tutorial = (ROOT / "docs" / "tutorial.md").read_text("utf-8").splitlines()
    lines = screen.table([(f"  {name}", what) for name, what in new.FILES.items()])
    assert set(lines) <= set(tutorial), set(lines) - set(tutorial)
