"""The page of every plant while it runs, on a laptop and on a phone: shots in build/screens."""

from pathlib import Path

import pytest
from free_bus import GROUP, own_port
from hosting import hosting
from paging import PHONE, WIDE, opened, shot, wait
from playwright.sync_api import Browser, Page

import pcpc
from pcpc.tools.start.rigs import ShippedRig, shipped_rigs

pytestmark = pytest.mark.browser

LIVE = {rig.plant: rig for rig in reversed([*shipped_rigs()])}
PATIENT = {"supervisor.hold_cycles": 10**6, "supervisor.fault_after_cycles": 10**6}
UNCLOCKED = {"backlash_map", "deadzone_map", "map_chains"}  # whose laws take longer than a period
STILL = {*UNCLOCKED, "probe"}  # whose motion may be over


def running(rig: ShippedRig) -> pcpc.Live:
    """Start a run of a rig, on its clock if its law allows it."""
    pacing, duration_s = ("lockstep", 1e6) if rig.plant in UNCLOCKED else ("real", 600.0)
    bus = f"udp_multicast:{GROUP}:{own_port()}"
    settings = {"duration_s": duration_s, **PATIENT}
    return pcpc.running(str(rig.path), pacing=pacing, set=settings, bus=bus)


def drawn(page: Page) -> int:
    """Return how many colours the drawing has."""
    return int(page.evaluate(
        "(() => { const c = document.getElementById('drawing');"
        " const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        " const seen = new Set(); for (let i = 0; i < d.length; i += 4)"
        " if (d[i + 3]) seen.add((d[i] << 16) | (d[i + 1] << 8) | d[i + 2]); return seen.size; })()"
    ))  # fmt: skip


@pytest.mark.parametrize("plant", LIVE)
def test_a_plant_is_shown_alive(browser: Browser, tmp_path: Path, plant: str) -> None:
    with (
        running(LIVE[plant]) as run,
        hosting(tmp_path, "--node", run._nodes["plant"].name) as host,
        opened(browser, host) as page,
    ):
        moves(page, plant)
        assert page.locator("#notice").is_hidden(), page.locator("#notice").inner_text()
        for name, size in (("live", WIDE), ("phone", PHONE)):
            page.set_viewport_size(size)  # type: ignore[arg-type]
            wait(page, "document.documentElement.scrollWidth <= innerWidth")
            page.wait_for_timeout(200)  # for a redraw
            shot(page, f"{name}-{plant}")


def moves(page: Page, plant: str) -> None:
    """Wait until the page of a run has curves, a load of the bus and a drawing that moves."""
    wait(page, "!document.getElementById('drawing-box').hidden")
    wait(page, "document.getElementById('bus-load').textContent")
    wait(page, "pcpc.panels.filter((one) => one.kind === 'time').every((one) => one.y?.some("
               "(y) => y.some((value) => !isNaN(value))))")  # fmt: skip
    assert drawn(page) > 8, plant
    picture = "document.getElementById('drawing').toDataURL()"
    if plant not in STILL:
        wait(page, f"old => {picture} !== old", page.evaluate(picture))
