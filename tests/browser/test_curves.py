"""What strangers see of curves: colours, newest values, zeros, and a plant that has no layout."""

import re
from collections.abc import Iterator
from typing import Any

import pytest
from hosting import Host, hosting
from paging import PHONE, opened, shot, wait
from playwright.sync_api import Browser, Page
from processes import pcpc as command

import pcpc

pytestmark = pytest.mark.browser

LAPTOP = {"width": 1280, "height": 1100}
ALL_DRAWN = "pcpc.panels.every((one) => one.x && !one.dirty)"
PUT = """(columns) => { const it = pcpc.panels[0]; it.held.clear();
  it.x = Float64Array.from(columns[0].keys()); it.y = columns.map((one) => Float32Array.from(one));
  it.draw(); }"""
ZEROS = """(units) => units.map((one) => pcpc.panels[0].chart.valToPos(0, `y ${one}`))"""
COLOURS = """() => [getComputedStyle(document.querySelector('.panel')).backgroundColor,
  ...[...document.querySelectorAll('.chip i')].map((one) => getComputedStyle(one).backgroundColor)]
"""
TICKS = "pcpc.panels[0].chart.axes.slice(1).map((axis) => axis._values)"
TAKE = "names => { const it = pcpc.panels[0]; it.names.splice(0); names.forEach((n) => it.add(n)) }"


@pytest.fixture(scope="module")
def barrel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Host]:
    folder = tmp_path_factory.mktemp("barrel")
    pcpc.simulate("hull", set={"duration_s": 2.0}, folder=folder / "run", quiet=True)
    with hosting(folder, str(folder / "run")) as one:
        yield one


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Host]:
    folder = tmp_path_factory.mktemp("bare")
    command("new", "--cart", "cart", cwd=folder)
    (folder / "cart" / "layout.json").unlink()
    pcpc.simulate(folder / "cart" / "rig.yaml", folder=folder / "run", quiet=True)
    with hosting(folder, str(folder / "run")) as one:
        yield one


def luminance(colour: str) -> float:
    """Return the relative luminance of rgb(r, g, b), as WCAG 2 defines it."""
    parts = [int(one) / 255.0 for one in re.findall(r"\d+", colour)[:3]]
    linear = [v / 12.92 if v <= 0.03928 else ((v + 0.055) / 1.055) ** 2.4 for v in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a: str, b: str) -> float:
    low, high = sorted((luminance(a), luminance(b)))
    return (high + 0.05) / (low + 0.05)


def take(page: Page, *names: str) -> None:
    page.evaluate(TAKE, list(names))
    wait(page, f"n => pcpc.panels[0].y?.length === n && {ALL_DRAWN}", len(names))


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [LAPTOP, PHONE], ids=["wide", "phone"])
def test_every_curve_is_seen_and_said(
    browser: Browser, barrel: Host, bare: Host, size: Any, scheme: str
) -> None:
    with opened(browser, bare, size, ALL_DRAWN, scheme) as page:
        shot(page, f"bare-{scheme}-{size['width']}")
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    with opened(browser, barrel, size, ALL_DRAWN, scheme) as page:
        shot(page, f"curves-{scheme}-{size['width']}")
        page.evaluate(
            "pcpc.laid([{kind: 'time', names: ["
            "...pcpc.variables.values()].filter((v) => v.plot).slice(0, 8)"
            ".map((v) => v.name)}])"
        )
        back, *curves = page.evaluate(COLOURS)
        least = min(contrast(back, one) for one in curves)
        assert len({*curves}) == 8 and least >= 3.0, f"{least:.2f} of {curves} on {back}"


def test_another_scheme_recolours_what_is_drawn(browser: Browser, barrel: Host) -> None:
    with opened(browser, barrel, LAPTOP, ALL_DRAWN, "light") as page:
        before = page.evaluate(COLOURS)
        page.emulate_media(color_scheme="dark")
        wait(page, f"old => ({COLOURS})()[1] !== old", before[1])
        wait(page, ALL_DRAWN)
        assert page.evaluate("pcpc.panels[0].chart.series[1].stroke().toLowerCase()") == "#56b4e9"


def test_the_legend_says_the_newest_value_and_that_at_the_cursor(
    browser: Browser, barrel: Host
) -> None:
    said = "document.querySelectorAll('.u-legend .u-value')[1].textContent"
    with opened(browser, barrel, LAPTOP, ALL_DRAWN) as page:
        take(page, "controller.e_rad")
        page.evaluate(PUT, [[*(0.25 * i for i in range(100))]])
        wait(page, f"{said} === '24.7500 rad'")
        over = page.locator(".u-over").first
        over.hover(position={"x": 2.0, "y": 40.0})
        wait(page, f"parseFloat({said}) < 1")
        page.mouse.move(1.0, 1.0)
        wait(page, f"{said} === '24.7500 rad'")


@pytest.mark.parametrize("size", [1e-9, 0.0], ids=["noise", "constant"])
def test_an_error_at_rest_has_ticks_that_differ(
    browser: Browser, barrel: Host, size: float
) -> None:
    with opened(browser, barrel, LAPTOP, ALL_DRAWN) as page:
        take(page, "controller.e_rad")
        page.evaluate(PUT, [[size * (i % 7 - 3) for i in range(100)]])
        page.wait_for_timeout(100)
        (ticks,) = page.evaluate(TICKS)
        shot(page, f"at-rest-{size:g}")
    assert len(ticks) == len({*ticks}) >= 3 and "-0" not in ticks, ticks
    assert {"0", "0.0"} & {*ticks}, ticks


def test_two_axes_have_their_zeros_at_one_height(browser: Browser, barrel: Host) -> None:
    names, units = ("controller.e_rad", "plant:barrel.gear_torque_Nm"), ["rad", "N m"]
    with opened(browser, barrel, LAPTOP, ALL_DRAWN) as page:
        take(page, *names)
        for first, second in (
            ([-1.0, 3.0], [-40.0, 2.0]),
            ([0.1, 0.2], [-9.0, -1.0]),
            ([0.0, 0.0], [4.0, 9.0]),
            ([-1e-9, 1e-9], [0.0, 1e6]),
        ):
            page.evaluate(PUT, [first, second])
            page.wait_for_timeout(100)
            a, b = page.evaluate(ZEROS, units)
            assert abs(a - b) < 0.5, f"{first} {second}: {a} and {b} px"
            for unit, values in zip(units, (first, second), strict=True):
                low, high = page.evaluate(
                    "one => (({min, max}) => [min, max])(pcpc.panels[0].chart.scales[`y ${one}`])",
                    unit,
                )
                assert low <= min(values) and max(values) <= high, (unit, values, low, high)
        page.evaluate(PUT, [[3.0001, 3.0002], [-1.0, 1.0]])  # whose zero is far off
        page.wait_for_timeout(100)
        assert page.evaluate("pcpc.panels[0].chart.scales['y rad'].min") > 3.0
        take(page, *names)
        shot(page, "two-axes")


def test_a_plant_without_a_layout_shows_what_it_is_told_and_does(
    browser: Browser, bare: Host
) -> None:
    with opened(browser, bare, LAPTOP, ALL_DRAWN) as page:
        panels = page.evaluate("pcpc.panels.map((one) => one.names)")
        units = page.evaluate("pcpc.panels.map((one) => [...new Set(one.units)])")
    shown = {name for panel in panels for name in panel}
    assert {"controller.e_m", "reference.value", "plant:cart.encoder_m",
            "plant:rx.CMD.force"} <= shown, panels  # fmt: skip
    assert len(panels) <= 4 and all(len(one) == 1 for one in units), (panels, units)
