"""What users of a package look for beside the code says the same as pyproject.toml."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def test_the_citation_is_of_this_version() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(cited), "the format demands them"
    assert (cited["version"], cited["license"]) == (PROJECT["version"], PROJECT["license"])
    assert [one["name"] for one in cited["authors"]] == [one["name"] for one in PROJECT["authors"]]


def test_the_newest_entry_of_the_change_log_is_this_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text("utf-8")
    day = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))["date-released"]
    first = re.findall(r"^## (.*)$", text, re.MULTILINE)[0]
    assert first == f"{PROJECT['version']}, {day.day} {day:%B %Y}"


def test_the_package_is_typed_and_says_for_whom_it_is() -> None:
    assert (ROOT / "pcpc/py.typed").is_file() and "Typing :: Typed" in PROJECT["classifiers"]
    assert PROJECT["authors"] and PROJECT["keywords"]
    assert "*Report a vulnerability*" in (ROOT / "SECURITY.md").read_text("utf-8")
