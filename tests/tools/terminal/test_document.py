"""A declared result, in each of the ways it is rendered."""

import io
import sys
from pathlib import Path

import pytest
from html_page import Page

from pcpc.tools.terminal.document import (
    Block,
    Bullets,
    Code,
    LabelledTexts,
    Note,
    Part,
    Picture,
    Section,
    Strong,
    Table,
    Verdict,
    html,
    markdown,
    show,
    terminal,
)
from pcpc.tools.terminal.html import page

EVIL = "<i>a|b`c"
ROWS = [("pd", 3.5), (Strong(EVIL), 12.25)]
WHOLE = Section("Metrics", [
    ("run ", Code("pcpc replay A"), " again"), Table(("law", "error"), ROWS, (1,)),
    Note("of the window"), Bullets(["one", EVIL]), LabelledTexts({"also": ["x", "y"]}),
    Verdict("ok", ["held"], True), Picture(b"\x89PNG", "a curve", "a.png"),
    Section("More", [Block("a\n  b")], folded=True), Section("Nothing", [Table(("a",), []), None]),
])  # fmt: skip


def test_a_page_has_all_of_it_and_names_are_text(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(page("a", [html(WHOLE)]))
    found = Page(tmp_path / "a.html")
    found.check_alone()
    assert found.tables["Metrics"][:3] == [["law", "error"], ["pd", "3.5"], [EVIL, "12.25"]]
    assert found.commands == ["pcpc replay A"] and found.text.count(EVIL) == 2
    assert 'class="verdict ok"' in found.source and "i" not in found.tags
    assert "Nothing" not in found.text and "a\n  b" in found.text


def test_markdown_has_all_of_it_and_cells_stay_in_their_table() -> None:
    lines = markdown(WHOLE).splitlines()
    assert lines[0] == "### Metrics" and "run `pcpc replay A` again" in lines
    at = lines.index("| law | error |")
    cells = ["| --- | ---: |", "| pd | 3.5 |", "| **<i>a\\|b'c** | 12.25 |"]
    assert lines[at + 1 : at + 4] == cells, lines
    assert "![a curve](a.png)" in lines and "<details><summary>More</summary>" in lines
    assert "Nothing" not in "".join(lines)


@pytest.mark.parametrize("width", [60, 100])
def test_a_terminal_has_all_but_pictures_within_its_width(
    width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    long = LabelledTexts({"also": ["word " * 30, "y"]}, 9, "  ")
    broad = Table(("name", *"abc"), [("law", "1" * 22, "", "2" * 22), ("x", "3", "4" * 9, "5")])
    lines = terminal(Section("Title", [WHOLE, long, broad]))
    assert lines[:3] == ["Title", "Metrics", "run pcpc replay A again"], lines
    assert max(map(len, lines)) <= width and "  also     word word" in "\n".join(lines)
    assert ("  a 1111111111111111111111, c 2222222222222222222222" in lines) == (width == 60), lines


def test_what_is_empty_is_left_out() -> None:
    empty: list[Part] = [None, "", Table(("a",), []), Section("a", [None]), LabelledTexts({})]
    for part in empty:
        assert html(part) == "" and markdown(part) == "" and terminal(part) == [], part


@pytest.mark.parametrize("is_terminal", [True, False])
@pytest.mark.parametrize(("name", "value"), [
    ("TERM", "xterm-256color"), ("TERM", "dumb"), ("FORCE_COLOR", "1"), ("FORCE_COLOR", ""),
    ("NO_COLOR", "1"), ("TTY_COMPATIBLE", "1"), ("TTY_COMPATIBLE", "0"),
])  # fmt: skip
def test_labels_are_bold_where_rich_would_make_them_bold(
    name: str, value: str, is_terminal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is not imported for them: that would be a thirtieth of a warm start."""
    from rich.console import Console
    from rich.text import Text

    class Stdout(io.StringIO):
        def isatty(self) -> bool:
            return is_terminal

    for one in ("FORCE_COLOR", "NO_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(one, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv(name, value)
    lines = ["run      pd, virtual", "         and [bold]more[/bold]", "short", "", "x" * 300]
    said, rich = Stdout(), Stdout()
    monkeypatch.setattr(sys, "stdout", said)
    show(lines, 9)
    monkeypatch.setattr(sys, "stdout", rich)
    console = Console(highlight=False, soft_wrap=True)
    for line in lines:
        console.print(Text.assemble((line[:9], "bold"), line[9:]))
    assert said.getvalue() == rich.getvalue()
