"""The rigs in the pages of the site, from the disk."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT
from playwright.sync_api import Browser, expect

pytestmark = pytest.mark.browser
BUILD = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "--site-dir"]
LATER = 120_000  # ms
EQUAL = re.compile("equal to pcpc .*: [0-9a-f]{16}, see the command below")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    subprocess.run([*BUILD, str(folder)], cwd=ROOT, env=environment, check=True)
    return folder


@pytest.mark.parametrize(
    ("page", "width", "scheme"),
    [("index", 1280, "light"), ("index", 390, "dark"), ("docs/book/chapter2", 390, "dark")],
)
def test_a_rig_runs_in_a_page_from_the_disk(
    page: str, width: int, scheme: str, browser: Browser, site: Path
) -> None:
    dark = scheme == "dark"
    own = browser.new_context(
        viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light"
    )
    tab, odd = own.new_page(), list[str]()
    tab.on("request", lambda one: odd.append(one.url))
    tab.on("pageerror", lambda one: odd.append(f"error: {one}"))
    tab.goto(f"file://{site}/{page}.html")
    tab.locator("div.rig").scroll_into_view_if_needed()
    rig = tab.frame_locator("div.rig iframe")
    expect(rig.locator("#state")).to_have_text("ready", timeout=LATER)
    rig.locator("#speed").select_option("Infinity")
    rig.locator("#go").click()
    expect(rig.locator("#digest")).to_have_text(EQUAL, timeout=LATER)
    for root in (tab.locator("html").first, rig.locator("html")):
        assert root.evaluate("(html) => html.scrollWidth <= innerWidth")
    back = rig.locator("body").evaluate("(body) => getComputedStyle(body).backgroundColor")
    assert (back == "rgb(255, 255, 255)") != dark, back
    with tab.expect_navigation():
        tab.get_by_role("link", name="Open it whole").click()
    expect(tab.locator("#state")).to_have_text("ready", timeout=LATER)
    own.close()
    assert not [one for one in odd if not re.match(r"file:///|blob:null/", one)], odd
