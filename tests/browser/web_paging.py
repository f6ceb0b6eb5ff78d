"""Pages of `pcpc generate web`, made and opened."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, Page, expect
from processes import pcpc

LATER = 120_000  # ms


def made(folder: Path, rig: str, *more: str) -> Path:
    """Return the page of a rig."""
    path = folder / "page.html"
    done = pcpc("generate", "web", rig, *more, "-o", str(path), "-q")
    assert done.code == 0, done
    return path


@contextmanager
def alone(browser: Browser, width: int = 1280, *, still: bool = False) -> Iterator[Page]:
    """Yield a tab in which every request but the file and its worker is an error."""
    own = browser.new_context(
        viewport={"width": width, "height": 900},
        reduced_motion="reduce" if still else "no-preference",
    )
    tab, odd = own.new_page(), list[str]()
    tab.on("request", lambda one: odd.append(one.url))
    tab.on("pageerror", lambda one: odd.append(f"error: {one}"))
    yield tab
    own.close()
    assert not [one for one in odd if not re.match(r"file:///[^?]*page\.html|blob:null/", one)], odd


def opened(page: Page, file: Path, link: str = "") -> None:
    """Load a page and wait until it is ready."""
    page.goto(f"file://{file}{link}")
    expect(page.locator("#state")).to_have_text("ready", timeout=LATER)


def run_to_the_end(page: Page) -> str:
    """Return what is told of the digest."""
    page.select_option("#speed", "Infinity")
    page.locator("#go").click()
    expect(page.locator("#digest")).not_to_have_text("", timeout=LATER)
    return page.locator("#digest").inner_text()
