"""`pcpc demo` in a browser: the first picture, and a log that plays until the run is there."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from paging import WIDE, wait
from places import PATIENCE_S
from playwright.sync_api import Browser, Page, expect

import pcpc

pytestmark = pytest.mark.browser

# A page of a rig of which `name` follows; before it, a log with a note
HOST = """
import sys
from pathlib import Path
from pcpc.executive.log import reader
from pcpc.tools.live.host import cli, commands, sources
page = commands.PageRequest(port=0)
door = cli.open_door(commands.HostRequest(page=page, once=True))
print(door.url, flush=True)
before = sources.of_log(reader.read(Path(sys.argv[1])))
before.note = "a log until then"
cli.serve(door, sources.FollowedRun("hull", before=before), page)
"""


def picture(page: Page) -> str:
    """Return a digest of what is drawn."""
    return hashlib.sha256(page.locator("#drawing").screenshot()).hexdigest()


def address(stream: Iterator[str]) -> str:
    """Return the first address that a program prints."""
    return next(word for line in stream for word in line.split() if word.startswith("http"))


def test_a_barrel_moves_and_can_be_tuned(browser: Browser, tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("pcpc")
    begin_s = time.monotonic()
    process = subprocess.Popen(
        [program, "demo", "--port", "0"], cwd=tmp_path, text=True, stderr=subprocess.PIPE
    )
    assert process.stderr is not None
    try:
        page = browser.new_page(viewport=WIDE)
        page.goto(address(process.stderr))
        expect(page.locator("#drawing")).to_be_visible(timeout=1e3 * PATIENCE_S)
        print(f"first picture in the browser after {time.monotonic() - begin_s:.2f} s")
        before = picture(page)
        page.wait_for_timeout(1000)
        assert picture(page) != before
        expect(page.locator("#nodes")).to_contain_text("executive RUN")
        expect(page.locator("#notice")).to_be_hidden()
        assert page.locator("#parameters input:enabled").count() > 3
        page.close()
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0


def test_a_log_plays_round_and_round_until_a_run_takes_its_place(
    browser: Browser, tmp_path: Path
) -> None:
    settings = {"duration_s": 1.0, "rate_hz": 200.0}
    run = pcpc.simulate("hull", set=settings, folder=tmp_path / "run")
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", HOST, str(run.path)], cwd=tmp_path, text=True,
        stdout=subprocess.PIPE, env=os.environ | {"XDG_STATE_HOME": str(tmp_path)},
    )  # fmt: skip
    assert process.stdout is not None
    try:
        page = browser.new_page(viewport=WIDE)
        page.goto(address(process.stdout))
        expect(page.locator("#notice")).to_have_text("a log until then", timeout=1e3 * PATIENCE_S)
        at = "+document.querySelector('#slider').value"
        wait(page, f"{at} > 0.6")
        wait(page, f"{at} < 0.4")
        before = picture(page)
        page.wait_for_timeout(500)
        assert picture(page) != before
        with pcpc.running("hull", "pd", pacing="real", set={**settings, "duration_s": 600.0}):
            expect(page.locator("#nodes")).to_contain_text("RUN", timeout=1e3 * PATIENCE_S)
            expect(page.locator("#notice")).to_be_hidden()
            expect(page.locator("#slider-box")).to_be_hidden()
        page.close()
    finally:
        process.kill()
        process.communicate()
