"""The documentation builds as a site: no dead link, no dead anchor, nothing from the network."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.deep

ROOT = Path(__file__).resolve().parents[2]
BUILD = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        [*BUILD, str(folder)], cwd=ROOT, env=environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
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
