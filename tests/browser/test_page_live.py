"""The page besides its curves: it records, needs no mouse, moves no more than is wanted."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hosting import LONG, hosting
from paging import PHONE, WIDE, opened, wait
from playwright.sync_api import Browser, Page, expect

import pcpc
from pcpc.executive.log import reader as logs

pytestmark = pytest.mark.browser

CONTROLS = "button, input, select, summary, .panel, [tabindex='0']"
# What Tab can reach, and what the focus is on: its name for those who do not see it
NAME = """(one) => one.ariaLabel || [...(one.labels ?? [])].map((l) => l.textContent).join(' ')
  || (one.matches('input, select') ? '' : one.textContent.trim())"""
SEEN = f"""() => [...document.querySelectorAll("{CONTROLS}")]
  .filter((one) => one.checkVisibility() && !one.disabled && one.tabIndex >= 0)
  .map((one, i) => (one.dataset.at = i, ({NAME})(one)))"""


@pytest.fixture(scope="module")
def run() -> Iterator[pcpc.Live]:
    with pcpc.running("hull", "pd", pacing="real", set=LONG) as live:
        yield live


@contextmanager
def page_of(browser: Browser, run: pcpc.Live, folder: Path, *words: str) -> Iterator[Page]:
    node = ("--node", run._nodes["plant"].name, "--recordings", str(folder / "rec"))
    with hosting(folder, *node, *words) as host, opened(browser, host) as page:
        yield page


def test_a_recording_begins_and_ends_with_a_button(
    browser: Browser, run: pcpc.Live, tmp_path: Path
) -> None:
    with page_of(browser, run, tmp_path, "--write") as page:
        page.click("#record")
        expect(page.locator("#recorded")).to_contain_text("recording, ")
        expect(page.locator("#bus-load")).to_contain_text("% of 1000 kbit/s; from executive")
        page.click("#snapshot")
        expect(page.locator("#recorded")).to_contain_text("hull-last.mcap: cycles")
        page.click("#record")
        expect(page.locator("#record")).to_have_text("record")
        page.click("#frames-box details summary")
        row = page.locator("#frames tr", has_text="rx FB_A")
        assert 4.5 < float(row.locator("td").nth(2).inner_text()) < 7.0  # ms, at 200 Hz
        ids = page.evaluate("[...document.querySelectorAll('[id]')].map((one) => one.id)")
        assert len(ids) == len(set(ids)), "an id is there twice"
    files = sorted((tmp_path / "rec").iterdir())
    assert len(files) == 2 and all(len(logs.read(file).node) == 2 for file in files)


@pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
def test_the_unit_of_a_parameter_stays_on_a_line(
    browser: Browser, run: pcpc.Live, tmp_path: Path, size: Any
) -> None:
    node = run._nodes["plant"].name
    with hosting(tmp_path, "--node", node) as host, opened(browser, host, size) as page:
        rows = page.evaluate(
            """[...document.querySelectorAll("#parameters label")].map((row) => [row.textContent,
            row.lastChild.offsetHeight / parseFloat(getComputedStyle(row).fontSize),
            row.lastChild.getBoundingClientRect().right, row.lastChild.scrollWidth
            - row.lastChild.clientWidth])"""
        )
        edge = page.evaluate("document.querySelector('#parameters').getBoundingClientRect().right")
    assert "controller.kv_Nms_radN m s/rad" in [name for name, *_ in rows], rows
    assert not [row for row in rows if row[1] > 2.0 or row[2] > edge or row[3] > 0], rows


def test_a_page_that_only_shows_records_nothing(
    browser: Browser, run: pcpc.Live, tmp_path: Path
) -> None:
    with page_of(browser, run, tmp_path) as page:
        expect(page.locator("#record")).to_be_disabled()
        expect(page.locator("#snapshot")).to_be_disabled()


def test_every_control_has_a_name_and_is_reached_by_tab(
    browser: Browser, run: pcpc.Live, tmp_path: Path
) -> None:
    with page_of(browser, run, tmp_path, "--write") as page:
        page.fill("#search-parameters", "controller.k")  # some of many
        names = page.evaluate(SEEN)
        assert len(names) > 30 and all(names), names
        page.evaluate("document.activeElement.blur()")
        reached, at = set(), "document.activeElement.dataset.at"
        for _ in range(len(names) + 10):
            page.keyboard.press("Tab")
            if (found := page.evaluate(at)) is not None:
                reached.add(int(found))
        missed = {name for i, name in enumerate(names) if i not in reached}
        assert not missed, missed


def test_a_curve_a_value_and_the_cursor_by_keyboard_alone(
    browser: Browser, run: pcpc.Live, tmp_path: Path
) -> None:
    with page_of(browser, run, tmp_path, "--write") as page:
        page.focus("#search")
        page.keyboard.type("muzzle")
        for key in ("ArrowDown", "ArrowDown", "Enter"):
            page.keyboard.press(key)
        chosen = page.evaluate("document.activeElement.dataset.name")
        second = page.evaluate("document.querySelectorAll('#variables li')[1].dataset.name")
        assert chosen == second and "muzzle" in chosen
        wait(page, "name => pcpc.panels[0].names.includes(name)", chosen)
        page.focus(".panel")
        for key in ("ArrowLeft", "Shift+ArrowLeft", "ArrowRight"):
            page.keyboard.press(key)
        wait(page, "pcpc.panels[0].chart.cursor.left > 100")
        page.focus("#pause")
        page.keyboard.press("Enter")
        expect(page.locator("#pause")).to_have_text("go on")


def test_who_wants_little_motion_sees_the_plant_move_once_a_second(
    browser: Browser, run: pcpc.Live, tmp_path: Path
) -> None:
    count = """() => new Promise((done) => {
      const end = performance.now() + 2500;
      let n = 0, old = pcpc.side.painted_ms;
      const look = () => {
        if (pcpc.side.painted_ms !== old) { n++; old = pcpc.side.painted_ms; }
        performance.now() < end ? requestAnimationFrame(look) : done(n);
      };
      look();
    })"""
    with page_of(browser, run, tmp_path) as page:
        page.emulate_media(reduced_motion="reduce")
        assert 1 <= page.evaluate(count) <= 3
        page.emulate_media(reduced_motion="no-preference")
        assert page.evaluate(count) > 5
