"""The pages of the book's chapters quote the laws as they are, and their exercises can be begun."""

import re
import shlex
from pathlib import Path

import pytest
from blocks import ROOT, blocks_of

from pcpc.executive.rig.reading import load_rig
from pcpc.tools import cli
from pcpc.tools.start.rigs import find

pytestmark = pytest.mark.deep

PAGES = sorted((ROOT / "docs" / "book").glob("chapter*.md"))
LINK = re.compile(r"\]\(([^)]*\.py)\)")
COMMAND = re.compile(r"`(pcpc (?:run|simulate|experiment) [^`]*)`")


def bare(text: str) -> str:
    """Return code without indentation and blank lines at its ends."""
    return "\n".join(line.strip() for line in text.strip().splitlines())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_quoted_lines_stand_in_a_source_that_the_page_links_to(page: Path) -> None:
    sources = [
        bare((page.parent / link).read_text("utf-8"))
        for link in LINK.findall(page.read_text("utf-8"))
    ]
    quotes = [block for block in blocks_of(page) if block.language == "python"]
    for block in quotes:
        found = any(f"\n{bare(block.text)}\n" in f"{source}\n" for source in sources)
        assert found, f"{block.where}: the law has changed; quote it as it is:\n{block.text}"
    assert quotes and sources


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_commands_of_the_exercises_are_accepted(page: Path) -> None:
    text = page.read_text("utf-8")
    commands = COMMAND.findall(text.replace("\n   ", " "))
    for command in commands:
        options = cli.parsed_options(shlex.split(command)[1:])
        if hasattr(options, "rig"):
            load_rig(find(options.rig), options.controller, options.set)
    assert commands and text.count("\n1. ") == text.count("\n3. ") == 1 and "\n4. " not in text
    assert "```math" in text and "](../" in text


def test_the_appendices_commands_are_accepted_and_name_the_laws_linked() -> None:
    page = ROOT / "docs" / "book" / "appendices.md"
    text = page.read_text("utf-8")
    lines = [line for block in blocks_of(page) for line in block.text.splitlines()]
    commands = [*COMMAND.findall(text), *lines]
    for command in commands:
        options = cli.parsed_options(shlex.split(command)[1:])
        if hasattr(options, "rig"):
            load_rig(find(options.rig), options.controller, options.set)
    laws = {line.split()[3] for line in lines if "--" not in line}
    linked = {Path(link).stem for link in LINK.findall(text)}
    assert len(laws) == 4 and laws <= linked, laws - linked


def test_there_is_a_page_for_every_chapter() -> None:
    assert [page.stem for page in PAGES] == [f"chapter{n}" for n in range(1, 10)]
