"""docs/reference tells what the parser and the docstrings say now."""

import importlib.util
import re
from typing import Any

import pytest
from places import ROOT

import pcpc
from pcpc.plants import evaluation

DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def reference() -> Any:
    """Return docs/site/reference.py, which imports all rooms: not in each worker."""
    spec = importlib.util.spec_from_file_location("reference", DOCS / "site" / "reference.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_written_pages_are_what_the_sources_say(reference: Any) -> None:
    for name, written in reference.PAGES.items():
        kept = (DOCS / "reference" / name).read_text("utf-8")
        assert kept == written(), f"docs/reference/{name} is not up to date; run `make reference`"
    by_hand = {f"schemas/{one.name}" for one in (DOCS / "reference/schemas").iterdir()}
    assert by_hand <= {*reference.PAGES}, by_hand - {*reference.PAGES}


def test_every_option_and_every_function_has_its_line(reference: Any) -> None:
    commands, api = reference.commands(), reference.api()
    for told in ("### pcpc run\n", "### pcpc log export\n", "\n--set NAME=VALUE ", "-- COMMAND"):
        assert told in commands, told
    assert all(f"## pcpc.{name}\n" in api for name in pcpc.__all__)
    python = reference.rig_python()
    for name in evaluation.__all__:
        assert re.search(rf"\b{name}\b", python), name
    for told in ("### port\n", "\nclip(x, low, high) ", "\nreferences:step\n    amplitude_rad "):
        assert told in python, told
    assert "\nmetrics: dict[str, float] " in api and "\nLive.wait_until(" in api
