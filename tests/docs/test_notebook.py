"""The notebook runs, and prints what stands in it."""

import importlib.util
from typing import Any

import nbformat
import pytest
from places import ROOT

pytestmark = pytest.mark.deep

SITE = ROOT / "docs" / "site"
SPEC = importlib.util.spec_from_file_location("notebook", SITE / "notebook.py")
assert SPEC is not None and SPEC.loader is not None
notebook = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(notebook)


def shown(cell: Any) -> list[str]:
    """Return what a cell printed, and that it drew."""
    return [
        output.get("text")
        or ("picture" if "image/png" in output.data else output.data["text/plain"])
        for output in cell.outputs
    ]


@pytest.mark.paced
def test_every_cell_prints_what_the_page_shows() -> None:
    kept = nbformat.read(notebook.NOTEBOOK, notebook.PLAIN)
    pairs = [
        (before, now)
        for before, now in zip(kept.cells, notebook.executed().cells, strict=True)
        if now.cell_type == "code"
    ]
    assert len(pairs) > 5 and any(shown(now) == ["picture"] for _, now in pairs)
    for before, now in pairs:
        assert shown(before) == shown(now), f"run `make notebook`:\n{now.source}"
    assert notebook.NOTEBOOK.stat().st_size < 300_000, "outputs are to stay small"
