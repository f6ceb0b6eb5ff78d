"""What stands at the axes of the page's curves: numbers that tell the ticks apart."""

from collections.abc import Iterator

import pytest
from hosting import Host, hosting
from paging import opened, shot, wait
from playwright.sync_api import Browser, Page

import pcpc

pytestmark = pytest.mark.browser

LABELS = "pcpc.panels[0].chart.axes.map((axis) => axis._values)"
ASKED = (
    "([ticks, step]) => {const c = pcpc.panels[0].chart;"
    " return c.axes[1].values(c, ticks, 1, 40, step)}"
)
ZOOMED = (
    "([a, b]) => {const x = pcpc.panels[0].chart.data[0];"
    " return x.length > 0 && x[0] >= a - 0.01 && x.at(-1) <= b + 0.01}"
)
CASES = [
    ([-4e-5, -2e-5, 0.0, 2e-5, 4e-5], 2e-5, ["-4e-5", "-2e-5", "0", "2e-5", "4e-5"]),
    ([2.9992, 2.9994, 2.9996], 2e-4, ["2.9992", "2.9994", "2.9996"]),
    ([0.0, 0.25, 0.5], 0.25, ["0.00", "0.25", "0.50"]),
    ([-1e-17, 0.1, 0.2], 0.1, ["0.0", "0.1", "0.2"]),
    ([-1e-21, 2.5e-8, 5e-8], 2.5e-8, ["0", "2.5e-8", "5.0e-8"]),
    ([-100.0, 0.0, 100.0], 100.0, ["-100", "0", "100"]),
    ([3.0000000001, 3.0000000002], 1e-10, ["3.0000000001", "3.0000000002"]),
    ([1.0e6, 1.5e6, 2.0e6], 5e5, ["1.0e6", "1.5e6", "2.0e6"]),
    ([12345.6789, 12345.6790], 1e-4, ["12345.6789", "12345.6790"]),
    ([5e-324, 1e-300], 1e-300, ["0", "1e-300"]),
    ([1e300, 2e300], 1e300, ["1e300", "2e300"]),
    ([7.0], 1.0, ["7"]),
    ([], 1.0, []),
]


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Host]:
    folder = tmp_path_factory.mktemp("axes")
    pcpc.simulate("probe", set={"duration_s": 4.0}, folder=folder / "run", quiet=True)
    with hosting(folder, str(folder / "run")) as one:
        yield one


def told(page: Page) -> list[list[str]]:
    """Return the labels of each axis of the first panel."""
    return [list(one) for one in page.evaluate(LABELS)]


def test_ticks_have_the_digits_that_their_step_needs(browser: Browser, host: Host) -> None:
    with opened(browser, host) as page:
        for ticks, step, expected in CASES:
            assert page.evaluate(ASKED, [ticks, step]) == expected, (ticks, step)


def test_a_value_at_rest_has_ticks_of_its_own(browser: Browser, host: Host) -> None:
    with opened(browser, host) as page:
        for span in ([0.0, 4.0], [2.0, 2.2], [3.0, 3.5], [3.9, 3.902]):
            page.evaluate("span => pcpc.zoom(span)", span)
            wait(page, ZOOMED, span)
            for labels in told(page):
                assert len(labels) == len({*labels}) >= 2, (span, labels)
                assert not {"-0", "-0.0", "-0.00"} & {*labels}, (span, labels)
            shot(page, f"axes-{span[0]:g}")
