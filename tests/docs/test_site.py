"""The documentation builds as a site: no dead link, no dead anchor, nothing from the network."""

import base64
import html
import importlib
import json
import logging
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import zstandard
from mkdocs.exceptions import PluginError
from places import ROOT

pytestmark = pytest.mark.deep

BUILD = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        [*BUILD, str(folder)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_every_page_of_the_repository_is_in_it_and_every_link_leads_somewhere(site: Path) -> None:
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "plants").rglob("*.md")]
    nav = (ROOT / "mkdocs.yml").read_text("utf-8")
    made = {path.relative_to(site).as_posix() for path in site.rglob("*.html")}
    for page in pages:
        name = page.relative_to(ROOT).as_posix()
        assert f"- {name}\n" in nav, f"{name}: no place under `nav` of mkdocs.yml"
        at = name.removesuffix(".md") + ".html"
        assert at.replace("README", "index") in made, at
    assert len(pages) > 15 and "index.html" in made


def test_a_link_to_a_source_file_shows_it(site: Path) -> None:
    assert "plants/probe/rig.yaml.html" in (site / "docs" / "rig.html").read_text("utf-8")
    assert "timing of the loop" in (site / "plants/probe/rig.yaml.html").read_text("utf-8")
    notebook = (site / "docs/notebooks/first_steps.ipynb.html").read_text("utf-8")
    assert "data:image/png;base64," in notebook and 'href="../tutorial.html"' in notebook


def test_no_page_loads_anything_from_the_network(site: Path) -> None:
    loads = re.compile(r'<(?:script|link|img)[^>]*?(?:src|href)="?(https?:[^">\s]+)')
    pages = [page for page in site.rglob("*.html") if page.name != "404.html"]  # only on a server
    found = {url for page in pages for url in loads.findall(page.read_text("utf-8"))}
    assert not found, found
    page = site / "docs" / "rig.html"
    (script,) = re.findall(r'<script src="([^"]*iframe-worker[^"]*)"', page.read_text("utf-8"))
    assert (page.parent / script).is_file(), script


def test_mathematics_is_shown_as_such(site: Path) -> None:
    page = (site / "docs/book/chapter3.html").read_text("utf-8")
    assert page.count("<math ") == 3 and "<mover><mi>q</mi><mo>..</mo></mover>" in page
    assert "```" not in page and "\\dot" not in page


RIGS = ["README.md", *(f"docs/book/chapter{number}.md" for number in range(1, 10))]
IFRAME = re.compile(r'<iframe src="([^"]+)" title="([^"]+)" loading="lazy"></iframe>')


@pytest.mark.parametrize("source", RIGS)
def test_the_first_page_and_each_chapter_have_a_rig_at_work(source: str, site: Path) -> None:
    (mark,) = re.findall("<!--rig:(.+):(.+)-->", (ROOT / source).read_text("utf-8"))
    name = source.removesuffix(".md").replace("README", "index")
    page = (site / f"{name}.html").read_text("utf-8")
    ((at, title),) = IFRAME.findall(page)
    assert (
        title.startswith(f"{mark[0]}, ") and f'<a href="{at}">' in page and "<!--rig:" not in page
    )
    file = (site / name).parent / html.unescape(at)
    (payload,) = re.findall(r'id="payload">([\w+/=]+)</script>', file.read_text("utf-8"))
    whole = zstandard.ZstdDecompressor().decompress(base64.b64decode(payload)[32:])
    about = json.loads(whole[4 : 4 + int.from_bytes(whole[:4], "little")])
    assert about["rig"] == mark[0] and not about["absent"]
    assert ",".join(one["name"] for one in about["controllers"]) == mark[1]
    assert all(re.fullmatch("[0-9a-f]{64}", one["digest"]) for one in about["controllers"])
    assert file.stat().st_size < 400_000


@pytest.fixture
def rig_pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return the module that makes the pages, with nothing kept."""
    monkeypatch.syspath_prepend(ROOT / "docs" / "site")
    found = importlib.import_module("rig_pages")
    monkeypatch.setattr(found, "ROOT", tmp_path)
    monkeypatch.setattr(found, "KEPT", tmp_path / "kept")
    monkeypatch.setattr(found, "_key", lambda: "key")
    return found


def test_without_a_compiler_one_line_says_that_pages_have_no_rig(
    rig_pages: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    (tmp_path / "ziglang.py").write_text("raise ImportError")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("PATH", "")
    mark = "<!--rig:probe:proportional-->"
    with caplog.at_level(logging.INFO):
        there = rig_pages.made(rig_pages.shown(mark) * 2)
    assert there == {} and len(caplog.messages) == 2, caplog.messages
    assert caplog.messages[1].startswith("Pages without a rig at work: no compiler for wasm32 here")
    assert "No page of probe here" in rig_pages.embedded(mark, "../", there)


def test_a_page_is_made_once_and_a_wrong_rig_ends_the_build(rig_pages: ModuleType) -> None:
    with pytest.raises(PluginError, match=r"no page of hull with nobody: .*nobody"):
        rig_pages.made(rig_pages.shown("<!--rig:hull:nobody-->"))
    wanted = rig_pages.shown("<!--rig:probe:proportional-->")
    (file,) = rig_pages.made(wanted).values()
    first = file.stat().st_mtime_ns
    assert [*rig_pages.made(wanted).values()] == [file] and file.stat().st_mtime_ns == first
    assert rig_pages.made([]) == {} and not file.exists(), "what no page shows is not kept"
