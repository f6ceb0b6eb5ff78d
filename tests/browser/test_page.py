"""The page of `pcpc host` in Chromium, over a run of real processes and over logs.

Screenshots for the eye are left in build/screens.
"""

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from free_bus import GROUP, own_port
from hosting import LONG, Host, hosting
from paging import DRAWN, PATIENT_MS, PHONE, opened, shot, wait
from places import PATIENCE_S
from playwright.sync_api import Browser, Page, expect

import pcpc
from pcpc.tools.start.rigs import shipped_rigs

pytestmark = pytest.mark.browser

GAIN = "controller.kv_Nms_rad"
ONE_OF_A_PLANT = {rig.plant: rig for rig in reversed([*shipped_rigs()])}


@pytest.fixture(scope="module")
def run() -> Iterator[pcpc.Live]:
    with pcpc.running("hull", "pd", pacing="real", set=LONG) as live:
        yield live


@pytest.fixture
def host(run: pcpc.Live, tmp_path: Path) -> Iterator[Host]:
    with hosting(tmp_path, "--write", "--node", run._nodes["plant"].name) as one:
        yield one


def newest(page: Page) -> float:
    """Return the time of the newest value of the first panel, before all if it has none."""
    return float(page.evaluate("pcpc.panels[0].chart.data[0].at(-1) ?? -1"))


def moves(page: Page) -> None:
    """Wait until curves and drawing are others than now."""
    before = page.evaluate("document.getElementById('drawing').toDataURL()")
    wait(page, "t => pcpc.panels[0].chart.data[0].at(-1) > t + 0.3", newest(page))
    wait(page, "old => document.getElementById('drawing').toDataURL() !== old", before)


def parameter(page: Page, name: str) -> Any:
    page.fill("#search-parameters", name)
    return page.locator("#parameters label", has_text=name).locator("input")


def test_curves_and_drawing_move_and_tell_what_the_node_says(
    browser: Browser, host: Host, run: pcpc.Live
) -> None:
    with opened(browser, host) as page:
        moves(page)
        expect(page.locator("#nodes")).to_contain_text("executive RUN")
        name = page.evaluate("pcpc.panels[1].names[2]")
        assert name == "plant:barrel.hull_rad"
        value = run[name]
        moves(page)  # by 0.3 s: the value of a moment ago is among the curve's
        low, high = page.evaluate(
            "(() => { const y = pcpc.panels[1].y[2].filter((v) => !Number.isNaN(v));"
            " return [Math.min(...y), Math.max(...y)]; })()"
        )
        assert low - 1e-8 < value < high + 1e-8 and high - low < 0.1  # rad: of the hull's motion
        page.fill("#search", "= 1000 * abs(controller.e_rad)")
        page.press("#search", "Enter")
        wait(page, "pcpc.panels[0].names.length === 3 && pcpc.panels[0].y?.length === 3")
        page.click("button[data-what=clear]")
        expect(page.locator("#answer")).to_contain_text("clear curves: from cycle")
        wait(page, "isNaN(pcpc.panels[0].y[0][0])")
        moves(page)
        over = page.locator(".u-over").first
        over.hover(position={"x": 0.97 * over.bounding_box()["width"], "y": 90.0})
        expect(page.locator(".u-legend .u-value").nth(1)).to_have_text(re.compile(r"-?0\.\d+"))
        shot(page, "live")


def test_a_curve_comes_between_new_values_and_their_drawing(browser: Browser, host: Host) -> None:
    with opened(browser, host) as page:  # whose end says what the page complained of
        page.evaluate(
            "() => new Promise((done) => { const timer = setInterval(() => {"
            " if (!pcpc.panels[0].dirty) return;"
            " clearInterval(timer); done(pcpc.panels[0].add('plant:barrel.theta_rad')); }, 1); })"
        )
        wait(page, "pcpc.panels[0].chart.series.length === 4 && pcpc.panels[0].y?.length === 3")
        moves(page)


def test_each_unit_has_a_scale_of_its_own(browser: Browser, host: Host) -> None:
    with opened(browser, host) as page:
        page.evaluate(
            "() => { const it = pcpc.panels[0]; it.names.splice(0); it.add('controller.e_rad');"
            " it.add('plant:barrel.theta_rad'); it.add('plant:barrel.gear_torque_Nm'); }"
        )
        wait(
            page, "isNaN(pcpc.panels[0].y?.[2][0]) && pcpc.panels[0].chart.scales['y N m'].max > 2"
        )
        found = page.evaluate(
            "() => { const it = pcpc.panels[0].chart;"
            " return [it.series.slice(1).map((one) => one.scale), it.axes.map((one) => one.label),"
            " it.scales['y rad'].max / it.scales['y N m'].max]; }"
        )
        assert found[:2] == [["y rad", "y rad", "y N m"], [None, "rad", "N m"]]
        assert 0.0 < found[2] < 0.01, "mrad and some N m, before the window is full"
        shot(page, "units")


def test_a_gain_changes_the_plant_and_stands_in_the_log(
    browser: Browser, host: Host, run: pcpc.Live
) -> None:
    def error() -> float:
        """Return the rms of the error over some seconds."""
        values, end = [], run.cycle + 400
        run.wait_until(
            lambda now: (values.append(now["controller.e_rad"]), run.cycle >= end)[1],
            within_s=PATIENCE_S,
        )
        return float(np.sqrt(np.mean(np.square(values))))

    with opened(browser, host) as page:
        moves(page)
        before = error()
        box = parameter(page, GAIN)
        box.fill("20")
        box.press("Enter")
        expect(page.locator("#answer")).to_contain_text("from cycle")
        told = int(re.search(r"cycle (\d+)", page.locator("#answer").inner_text())[1])  # type: ignore
        assert run[GAIN] == 20.0
        assert error() > 1.5 * before
        noted = page.locator("#events li", has_text=f"cycle {told} ")
        expect(noted.first).to_contain_text(f"{GAIN} = 20")
        box.fill("1e9")
        box.press("Enter")
        expect(page.locator("#answer")).to_contain_text("outside 0..1000")
        expect(box).to_have_value("20")
        box.fill("much")
        box.press("Enter")
        expect(page.locator("#answer")).to_contain_text("no number; 0 .. 1000")
        assert run[GAIN] == 20.0
        page.click("#undo")
        expect(box).to_have_value("110")
        assert run[GAIN] == 110.0
    TOLD.append((told, 20.0))


TOLD: list[tuple[int, float]] = []


def test_undo_shows_its_value_though_a_status_with_it_came_before_the_answer(
    browser: Browser, host: Host, run: pcpc.Live
) -> None:
    """A status tells a value once: one that came while the field was typed on is shown then."""
    before = run[GAIN]
    with opened(browser, host) as page:
        box = parameter(page, GAIN)
        box.fill("21")
        box.press("Enter")
        expect(page.locator("#answer")).to_contain_text("from cycle")
        wait(page, f"pcpc.side.values.get('{GAIN}') === 21")
        page.evaluate(
            "([name, before]) => { const net = pcpc.net, ask = net.ask.bind(net);"
            " net.ask = async (message) => { const answer = await ask(message);"
            " while (pcpc.side.values.get(name) !== before)"
            " await new Promise(requestAnimationFrame);"
            " return answer; }; }",
            [GAIN, before],
        )
        box.fill("much")
        page.click("#undo")
        expect(page.locator("#answer")).to_contain_text("undone")
        expect(box).to_have_value(f"{before:g}")


def test_it_finds_back_after_a_reload_and_a_restart(
    browser: Browser, run: pcpc.Live, tmp_path: Path
) -> None:
    node = ("--node", run._nodes["plant"].name)
    with hosting(tmp_path, *node) as host, opened(browser, host) as page:
        page.click("#add-panel")
        page.fill("#search", "controller.e_rad")
        page.press("#search", "Enter")
        names = "pcpc.panels.map((panel) => panel.names)"
        before = page.evaluate(names)
        assert before[-1] == ["controller.e_rad"]
        page.reload()
        expect(page.locator("#link")).to_have_text("connected", timeout=PATIENT_MS)
        wait(page, "pcpc.panels.length > 0")
        assert page.evaluate(names) == before
        moves(page)
        host.process.send_signal(signal.SIGKILL)
        host.process.wait()
        expect(page.locator("#link")).to_have_text("reconnecting", timeout=PATIENT_MS)
        with hosting(tmp_path, *node, port=host.port) as again:
            assert again.token == host.token
            expect(page.locator("#link")).to_have_text("connected", timeout=PATIENT_MS)
            assert page.evaluate(names) == before
            moves(page)


def test_pause_zoom_and_a_layout_with_what_is_gone(browser: Browser, host: Host) -> None:
    with opened(browser, host) as page:
        moves(page)
        page.click("#pause")
        expect(page.locator("#pause")).to_have_text("go on")
        wait(page, "pcpc.panels[0].x && pcpc.panels[0].chart.data[0].length > 10")
        still = float(page.evaluate("pcpc.still[1]"))
        box = page.locator(".u-over").first.bounding_box()
        y = box["y"] + box["height"] / 2
        page.mouse.move(box["x"] + box["width"] * 0.4, y)
        page.mouse.down()
        page.mouse.move(box["x"] + box["width"] * 0.6, y, steps=4)
        page.mouse.up()
        wait(page, "(t) => pcpc.span[1] < t && pcpc.span[0] > pcpc.still[0]", still)
        shown = "pcpc.panels[0].chart.data[0]"
        ends = f"(x => x[0] - pcpc.span[0] + pcpc.span[1] - x.at(-1))({shown})"
        wait(page, f"Math.abs({ends}) < 0.02 && {shown}.at(-1) < {still}")
        page.keyboard.press("Escape")
        page.evaluate("document.activeElement.blur()")
        page.keyboard.press("Space")
        expect(page.locator("#pause")).to_have_text("pause")
        moves(page)
        page.evaluate("pcpc.laid([{kind: 'time', names: ['controller.gone', 'controller.e_rad']}])")
        expect(page.locator("#notice")).to_contain_text("controller.gone")
        assert page.evaluate("pcpc.panels.map((panel) => panel.names)") == [["controller.e_rad"]]


def test_of_two_runs_one_is_chosen_and_stays_after_a_reload(
    browser: Browser, tmp_path: Path
) -> None:
    def begin() -> Any:
        return pcpc.running(
            "sin1.0", "pd", pacing="real", set=LONG, bus=f"udp_multicast:{GROUP}:{own_port()}"
        )

    asks = "!document.getElementById('chooser').hidden"
    with (
        begin() as one,
        begin() as two,
        hosting(tmp_path, "sin1.0", "--write") as host,
        opened(browser, host, ready=asks) as page,
    ):
        names = [live._nodes["plant"].name.rpartition(".")[0] for live in (one, two)]
        expect(page.locator("#chooser-title")).to_have_text("2 runs are in progress; choose one")
        row = page.locator("#chooser tr", has_text=names[1])
        expect(row).to_contain_text("sin1.0")
        expect(row).to_contain_text("executive")
        shot(page, "chooser")
        row.locator("button").click()
        expect(page.locator("#chooser")).to_be_hidden()
        wait(page, DRAWN)
        moves(page)
        box = parameter(page, GAIN)
        box.fill("120")
        box.press("Enter")
        expect(page.locator("#answer")).to_contain_text("from cycle")
        assert (one[GAIN], two[GAIN]) == (110.0, 120.0)
        page.reload()
        wait(page, DRAWN)
        expect(page.locator("#runs")).to_have_value(names[1])
        expect(parameter(page, GAIN)).to_have_value("120")
        page.locator("#runs").select_option(names[0])
        expect(parameter(page, GAIN)).to_have_value("110")
        moves(page)
        shot(page, "two-runs")
        one.stop()
        expect(page.locator("#nodes")).to_contain_text("executive ended")
        expect(page.locator("#runs option:checked")).to_have_text(f"{names[0]} (does not run)")


def test_a_curve_that_cannot_be_had_costs_no_other(browser: Browser, host: Host) -> None:
    with opened(browser, host) as page:
        names = page.evaluate("pcpc.panels[0].names")
        for wrong, why in {
            "=": "wants an expression",
            "= nosuch": "nosuch",
            "= controller.e_rad + controller.tau_Nm": "unit",
            "= " + "1 + " * 100 + "controller.e_rad": "at most 300 characters",
        }.items():
            page.fill("#search", wrong)
            page.press("#search", "Enter")
            expect(page.locator(".panel .why").first).to_contain_text(why)
            assert page.input_value("#search") == wrong, "what was written can be corrected"
            wait(page, "names => '' + pcpc.panels[0].names === '' + names", names)
        moves(page)
        page.evaluate(
            "[...pcpc.variables.values()].filter((one) => one.plot)"
            ".slice(0, 40).forEach((one) => pcpc.panels[0].add(one.name))"
        )
        expect(page.locator(".panel .why").first).to_contain_text("at most 32 curves")
        wait(page, "pcpc.panels[0].names.length === 32 && pcpc.panels[0].y?.length === 32")
        expect(page.locator("#link")).to_have_text("connected")
        moves(page)
        page.evaluate("pcpc.laid([{kind: 'time', names: ['controller.e_rad', '= nosuch']}])")
        moves(page)
        box = parameter(page, GAIN)
        for _ in range(8):  # as many as there ever were panels
            box.fill("-1")
            box.press("Enter")
            expect(box).to_have_value("110")  # the answer has come
        expect(page.locator("#answer")).to_contain_text("outside 0..1000")
        assert "outside" not in "".join(page.locator(".why").all_inner_texts())


def test_a_drawing_without_room_stops_nothing(browser: Browser, host: Host) -> None:
    with opened(browser, host) as page:  # whose end says what the page complained of
        moves(page)
        room = "document.getElementById('drawing').style.height"
        page.evaluate(f"{room} = '4px'")
        before = page.evaluate("pcpc.side.painted_ms")
        wait(page, "before => pcpc.side.painted_ms > before + 500", before)
        page.evaluate(f"{room} = ''")
        moves(page)


def test_a_page_in_haste_is_no_flood(browser: Browser, host: Host) -> None:
    with opened(browser, host) as page:
        page.evaluate(
            "() => new MutationObserver(() => { pcpc.cut = true; })"
            ".observe(document.getElementById('link'), {childList: true})"
        )
        width = page.evaluate(
            "() => { for (let i = 0; i < 1000; i++) { pcpc.window_s = 1 + i / 1000; pcpc.again(); }"
            " return pcpc.window_s; }"
        )  # as a window that is drawn larger, or a slider, does
        wait(page, "pcpc.net.wishes.size === 0")
        moves(page)
        shown = "(x => x.at(-1) - x[0])(pcpc.panels[0].chart.data[0])"
        wait(page, f"width => Math.abs({shown} - width) < 0.1", width)
        assert not page.evaluate("pcpc.cut")


def test_a_wrong_token_and_a_page_that_only_shows(
    browser: Browser, run: pcpc.Live, tmp_path: Path
) -> None:
    with hosting(tmp_path, "--node", run._nodes["plant"].name) as host:
        with opened(browser, host, PHONE) as page:
            expect(page.locator("#answer")).to_contain_text("view only")
            expect(parameter(page, GAIN)).to_be_disabled()
            wide = page.evaluate("document.documentElement.scrollWidth")
            assert wide <= PHONE["width"], "a phone would have to scroll sideways"
            shot(page, "phone")
        page = browser.new_page()
        page.goto(f"http://{host.name}/#wrong")
        expect(page.locator("#link")).to_contain_text("wrong token")
        page.close()


@pytest.mark.parametrize("plant", ONE_OF_A_PLANT)
def test_a_log_of_every_plant_has_a_slider_that_moves_it(
    browser: Browser, plant: str, tmp_path: Path
) -> None:
    rig = ONE_OF_A_PLANT[plant]
    pcpc.simulate(rig.path, set={"duration_s": 1.0}, folder=tmp_path / "run", quiet=True)
    with hosting(tmp_path, str(tmp_path / "run")) as host, opened(browser, host) as page:
        expect(page.locator("#nodes")).to_have_text("finished log")
        wait(page, "!document.getElementById('drawing-box').hidden")
        assert page.locator("#notice").is_hidden(), page.locator("#notice").inner_text()
        picture = "document.getElementById('drawing').toDataURL()"
        before = page.evaluate(picture)
        page.evaluate(
            "(() => { const s = document.getElementById('slider'); s.value = 0.5;"
            " s.dispatchEvent(new Event('input')); })()"
        )
        wait(page, "Math.abs(pcpc.instant - 0.5) < 1e-9")
        wait(page, f"old => {picture} !== old", before)
        page.click("#play")
        wait(page, "document.getElementById('slider').value > 0.6")
        shot(page, f"log-{plant}")


def test_the_log_has_the_tunings_of_the_page(run: pcpc.Live) -> None:
    run.stop()
    tuned = [(e["cycle"], e["value"]) for e in run.run.events if e.get("name") == GAIN]
    assert TOLD and set(TOLD) <= set(tuned), os.fspath(run.run.path)


def test_an_operator_holds_arms_and_hands_over(browser: Browser, tmp_path: Path) -> None:
    with pcpc.running("hull", "pd", standby=["pd_nn"], pacing="real", set=LONG) as run:
        node = run._nodes["plant"].name
        with (
            hosting(tmp_path, "--write", "--node", node) as host,
            opened(browser, host) as page,
        ):
            box, nodes = page.locator("#operate"), page.locator("#nodes")
            expect(box).to_contain_text("pd is in charge")
            box.get_by_text("hold", exact=True).click()
            expect(nodes).to_contain_text("executive READY")
            box.get_by_text("arm", exact=True).click()
            expect(nodes).to_contain_text("executive RUN")
            box.get_by_text("hand over to pd_nn").click()
            expect(box).to_contain_text("pd_nn is in charge")
            expect(page.locator("#answer")).to_contain_text("hand over to pd_nn: from cycle")
            expect(box.get_by_text("hand over to pd", exact=True)).to_be_enabled()
            assert run["handover.in_charge"] == 1.0
            shot(page, "operate")
        with hosting(tmp_path, "--node", node) as host, opened(browser, host) as page:
            expect(page.locator("#operate").get_by_text("hold", exact=True)).to_be_disabled()
