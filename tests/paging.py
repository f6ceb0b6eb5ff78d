"""A page of the host in a browser, and what is waited for in it. Screenshots: build/screens."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hosting import Host
from playwright.sync_api import Browser, Page, expect

SCREENS = Path(__file__).resolve().parents[1] / "build" / "screens"
WIDE, PHONE = {"width": 1400, "height": 950}, {"width": 390, "height": 844}
PATIENT_MS = 30_000.0
DRAWN = "pcpc.panels.some((panel) => panel.x || panel.points)"


@contextmanager
def opened(
    browser: Browser, host: Host, size: Any = WIDE, ready: str = DRAWN, scheme: Any = None
) -> Iterator[Page]:
    """Open the page; whatever it complains of, and every foreign address, is an error."""
    context = browser.new_context(viewport=size, color_scheme=scheme)
    page = context.new_page()
    said: list[str] = []
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: said.append(str(error.stack)))
    page.on(
        "request",
        lambda request: (
            said.append(f"asks {request.url}")
            if not request.url.startswith((f"http://{host.name}/", "data:"))
            else None
        ),
    )
    page.set_default_timeout(PATIENT_MS)
    page.goto(host.url)
    expect(page.locator("#link")).to_have_text("connected", timeout=PATIENT_MS)
    wait(page, ready)
    yield page
    lost = [line for line in said if "ERR_CONNECTION_REFUSED" not in line]  # while it restarts
    assert not lost, lost
    context.close()


def wait(page: Page, holds: str, arg: object = None) -> None:
    """Wait until an expression, or a function of `arg`, is true in the page.

    From outside: the page's own rules forbid what `wait_for_function` would evaluate in it.
    """
    for _ in range(int(PATIENT_MS / 50)):
        if page.evaluate(holds, arg):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"never: {holds}")


def shot(page: Page, name: str) -> None:
    SCREENS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENS / f"{name}.png")
