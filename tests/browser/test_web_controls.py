"""What a reader of a page of `pcpc generate web` changes: panels and disturbances, by keyboard."""

import re
import shlex
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from web_paging import alone, made, opened, run_to_the_end

from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.web.contents import digest
from pcpc.tools.make.web.program import Program
from pcpc.tools.start.rigs import find

pytestmark = pytest.mark.browser
OWN = "schedule=[{at_s: 1.5, set: {controller.kv_Nms_rad: 90}}]"
CONTROLS = "button, select, input, summary"
THERE = "(all) => all.filter((one) => one.checkVisibility() && !one.disabled).length"
WALKED = """() => {
  const one = document.activeElement, style = getComputedStyle(one);
  if (one === document.body) return "";
  one.dataset.walked = 1;
  return style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 1 ? "" : one.outerHTML;
}"""
NEWEST = "(name) => valueText(page.run.place(name).values[page.run.done - 1], 'rad')"
COUNTED = """() => {
  const draw = page.draw; page.draws = 0; page.since = performance.now();
  page.draw = function () { page.draws += 1; draw.call(page); };
}"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of the barrel with one controller and one entry in its schedule."""
    folder = tmp_path_factory.mktemp("web")
    return made(folder, "hull", "--controller", "pd", "--set", "duration_s=2", "--set", OWN)


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    with alone(browser) as tab:
        yield tab


def test_panels_are_changed_from_the_keyboard_and_stand_in_the_link(page: Page, file: Path) -> None:
    opened(page, file)
    expect(page.locator(".panel")).to_have_count(3)
    page.get_by_role("button", name="+ phase plane").press("Enter")
    for words, name in (
        ("truth inertial hub angle", "plant:barrel.theta_rad"),
        ("rad/s filtered (3)", "controller.r_rad_s"),
    ):
        expect(page.locator("#find")).to_be_focused()
        page.keyboard.press("Control+A")
        page.keyboard.type(words)
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        expect(page.locator("#panels-said")).to_have_text(f"{name} is in panel 4")
        page.keyboard.press("Shift+Tab")
    name = "phase plane: controller.r_rad_s over plant:barrel.theta_rad"
    expect(page.get_by_role("img", name=name)).to_be_visible()
    page.get_by_role("button", name="close this panel").first.press("Enter")
    page.get_by_role("button", name="take plant:barrel.hull_rad away").press("Enter")
    expect(page.get_by_role("group", name="panel 1").get_by_role("button").first).to_be_focused()
    link = page.evaluate("location.hash")
    other = f"{link}%3Bphase%2Cnobody%3Bround"
    page.goto("about:blank")
    opened(page, file, other)
    expect(page.locator("#notice")).to_contain_text("no such variable: nobody")
    expect(page.locator("#notice")).to_contain_text("round: there are time, phase")
    expect(page.get_by_role("img", name=name)).to_be_visible()
    expect(page.get_by_role("group", name="panel 1")).not_to_contain_text("hull_rad")
    page.locator("#usual").press("Enter")
    assert "panels" not in page.evaluate("location.hash")


def test_the_words_beside_curves_are_the_newest_values_and_the_scales(
    page: Page, file: Path
) -> None:
    opened(page, file, "#panels=time,controller.e_rad,controller.tau_Nm,controller.r_rad_s")
    page.select_option("#window", "Infinity")
    run_to_the_end(page)
    newest = page.evaluate(NEWEST, "controller.e_rad")
    legend = page.locator(".u-legend")
    expect(legend).to_contain_text(newest)
    expect(legend).to_contain_text(
        re.compile(r"controller\.r_rad_s.* rad/s \(.* to .* over the height\)")
    )
    expect(page.get_by_role("img", name=f"controller.e_rad = {newest}")).to_be_visible()


def test_each_control_has_a_name_and_is_reached_with_its_focus_in_sight(
    page: Page, file: Path
) -> None:
    opened(page, file)
    page.locator("details").evaluate_all("(all) => all.forEach((one) => { one.open = true; })")
    page.locator("#find").fill("torque")
    count = page.locator(CONTROLS).evaluate_all(THERE)
    page.locator("#find").evaluate("(one) => one.blur()")
    assert not [odd for _ in range(count + 3) if (odd := _tab(page))]
    assert page.locator("[data-walked]").count() == count > 30
    tree = page.context.new_cdp_session(page).send("Accessibility.getFullAXTree")["nodes"]
    focusable = [
        one
        for one in tree
        if any(each["name"] == "focusable" for each in one.get("properties", []))
        and one["role"]["value"] not in ("RootWebArea", "list")
    ]
    assert len(focusable) >= count
    assert not [one for one in focusable if not one["name"]["value"]]


def _tab(page: Page) -> str:
    page.keyboard.press("Tab")
    return str(page.evaluate(WALKED))


def test_a_press_at_a_cycle_has_the_digest_of_the_command_that_is_shown(
    page: Page, file: Path
) -> None:
    opened(page, file)
    page.keyboard.press(">")
    button = page.get_by_role("button", name="controller.kv_Nms_rad = 90 now")
    button.press("Enter")
    expect(page.locator("#answer")).to_contain_text("= 90 from cycle 100 on")
    expect(button).to_be_focused()
    expect(page.get_by_role("slider", name="controller.kv_Nms_rad")).to_have_attribute(
        "aria-valuetext", "90 N m s/rad"
    )
    said = run_to_the_end(page)
    words = shlex.split(page.locator("#command").inner_text())
    settings = [text for flag, text in pairwise(words) if flag == "--set"]
    rig = load_rig(Path(find("hull")), "pd", settings)
    assert said.split()[1].rstrip(";") == digest(Program(rig), in_memory(rig))[:16]


def test_before_a_run_a_press_is_how_it_begins_and_the_focus_stays(page: Page, file: Path) -> None:
    opened(page, file)
    button = page.get_by_role("button", name="fire now")
    button.press("Enter")
    expect(page.locator("#answer")).to_contain_text("fire = 1")
    expect(button).to_be_focused()
    assert "barrel.fire=1" in page.evaluate("decodeURIComponent(location.hash)")
    assert "equal to" not in run_to_the_end(page)


def test_who_wants_little_motion_sees_two_pictures_a_second(browser: Browser, file: Path) -> None:
    with alone(browser, 390, still=True) as page:
        opened(page, file)
        page.evaluate(COUNTED)
        page.locator("#go").click()
        expect(page.locator("#state")).to_contain_text("judged", timeout=30_000)
        draws, seconds = page.evaluate("[page.draws, (performance.now() - page.since) / 1000]")
        assert draws <= 2 * seconds + 3, (draws, seconds)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert not page.evaluate("document.getAnimations().length")
