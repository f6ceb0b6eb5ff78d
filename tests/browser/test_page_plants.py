"""The page of every plant while it runs, on a laptop and on a phone: shots in build/screens."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hosting import ANSWER_S, hosting
from paging import PHONE, WIDE, opened, shot, wait
from playwright.sync_api import Browser, Page

from pcpc.executive.loop import shared as sh
from pcpc.executive.nodes import live as nodes
from pcpc.tools.rigs import Shipped, shipped

pytestmark = pytest.mark.browser

LIVE = [*{rig.plant: rig for rig in reversed([*shipped()])}.values()]
PATIENT = ["supervisor.hold_cycles=1000000",
           "supervisor.fault_after_cycles=1000000"]  # fmt: skip
STILL = {"backlash_map", "deadzone_map", "probe"}  # whose motion may be over


class Run:
    """A run of a rig, on its clock if its law and the machine allow it."""

    def __init__(self, rig: Shipped, folder: Path) -> None:
        self.rig, self._folder, self._tries = rig, folder, 0
        self._begin()

    def _begin(self) -> None:
        self._tries += 1
        unclocked = self.rig.plant in ("deadzone_map", "backlash_map") or self._tries > 2
        pacing = "lockstep" if unclocked else "real"
        long = "duration_s=1000000" if unclocked else "duration_s=600"
        words = [f"--set={one}" for one in (long, *PATIENT)]
        folder = self._folder / f"{self.rig.plant}-{self._tries}"
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pcpc.tools.cli", "run", str(self.rig.path), "--quiet",
             "--pacing", pacing, "--no-figure", "-o", str(folder), *words],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def goes_on(self) -> None:
        """Return once all its nodes do; again where a busy machine tore its nodes apart."""
        while True:
            if self._process.poll() is not None:
                assert self._tries < 4, self._process.communicate()[1]
                self._begin()
            found = nodes.running(self.rig.name).values()
            if len(found) > 1 and all(int(one.block["control"][sh.CYCLE]) > 50 for one in found):
                return
            self._process.poll()
            time.sleep(0.05)

    def end(self) -> None:
        """End it as Ctrl-C does."""
        self._process.send_signal(signal.SIGINT)
        self._process.communicate(timeout=ANSWER_S)


def drawn(page: Page) -> int:
    """Return how many colours the drawing has."""
    return int(page.evaluate(
        "(() => { const c = document.getElementById('drawing');"
        " const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        " const seen = new Set(); for (let i = 0; i < d.length; i += 4)"
        " if (d[i + 3]) seen.add((d[i] << 16) | (d[i + 1] << 8) | d[i + 2]); return seen.size; })()"
    ))  # fmt: skip


def test_every_plant_is_shown_alive(browser: Browser, tmp_path: Path) -> None:
    going = [Run(LIVE[0], tmp_path)]
    try:
        for i, rig in enumerate(LIVE):  # the next one starts while this one is looked at
            going[0].goes_on()
            with hosting(tmp_path, str(rig.path)) as host, opened(browser, host) as page:
                if i + 1 < len(LIVE):
                    going.append(Run(LIVE[i + 1], tmp_path))
                moves(page, rig)
                assert page.locator("#notice").is_hidden(), page.locator("#notice").inner_text()
                for name, size in (("live", WIDE), ("phone", PHONE)):
                    page.set_viewport_size(size)  # type: ignore[arg-type]
                    wait(page, "document.documentElement.scrollWidth <= innerWidth")
                    page.wait_for_timeout(200)  # for a redraw
                    shot(page, f"{name}-{rig.plant}")
            going.pop(0).end()
    finally:
        for one in going:
            one.end()


def moves(page: Page, rig: Shipped) -> None:
    """Wait until the page of a run has curves, a load of the bus and a drawing that moves."""
    wait(page, "!document.getElementById('drawing-box').hidden")
    wait(page, "document.getElementById('bus-load').textContent")
    wait(page, "pcpc.panels.filter((one) => one.kind === 'time').every((one) => one.y?.some("
               "(y) => y.some((value) => !isNaN(value))))")  # fmt: skip
    assert drawn(page) > 8, rig.plant
    picture = "document.getElementById('drawing').toDataURL()"
    if rig.plant not in STILL:
        wait(page, f"old => {picture} !== old", page.evaluate(picture))
