"""A page of `pcpc generate web` in real browsers, from a file."""

import json
import re
import shlex
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from firefox import firefox
from playwright.sync_api import Browser, Page, expect
from processes import pcpc
from web_paging import LATER, alone, made, opened, run_to_the_end

from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.web.contents import digest
from pcpc.tools.make.web.program import Program
from pcpc.tools.start.rigs import find, shipped_rigs

pytestmark = pytest.mark.browser
ONE_OF_A_PLANT = {rig.plant: rig for rig in reversed([*shipped_rigs()])}
PAINTED = """(canvas) => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height)
    .data.filter((value, i) => i % 4 === 3 && value).length"""  # pixels
EQUAL = re.compile("equal to pcpc .*: [0-9a-f]{16}, see the command below")


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of the barrel with three controllers that differ."""
    return made(tmp_path_factory.mktemp("web"), "hull", "--set", "duration_s=2")


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """Return a tab in which a request is an error."""
    with alone(browser) as tab:
        yield tab


@pytest.mark.parametrize("plant", ONE_OF_A_PLANT)
def test_a_rig_of_each_plant_gives_the_digest_of_the_native_run(
    plant: str, page: Page, tmp_path: Path
) -> None:
    path = ONE_OF_A_PLANT[plant].path
    opened(page, made(tmp_path, str(path)))
    assert EQUAL.fullmatch(run_to_the_end(page))
    drawing = page.locator("#drawing")
    assert drawing.is_visible() and "no data" not in str(drawing.get_attribute("aria-label"))
    assert drawing.evaluate(PAINTED) > 100
    word = "ok, [0-9]+ judged" if load_rig(path).evaluation else "nothing judged"
    expect(page.locator("#state")).to_have_text(re.compile(word))


def test_each_controller_in_firefox(file: Path) -> None:
    with firefox() as tab:
        tab.goto(f"file://{file}")
        names = tab.value(
            "new Promise((done) => { const all = document.getElementById('controller').options;"
            "const look = () => all.length ? done([...all].map((one) => one.value).join(' '))"
            ": setTimeout(look, 20); look(); })"
        )
        assert len(names.split()) > 10
        for name in names.split():
            said = tab.value(
                "new Promise((done) => { const by = (id) => document.getElementById(id);"
                f"by('controller').value = '{name}'; by('controller').onchange();"
                "by('speed').value = 'Infinity'; by('go').click();"
                "const look = () => by('digest').textContent ? done(by('digest').textContent)"
                ": setTimeout(look, 20); look(); })"
            )
            assert EQUAL.fullmatch(said), (name, said)


def test_what_was_changed_has_the_digest_of_the_command_that_is_shown(
    page: Page, file: Path
) -> None:
    opened(page, file, "#controller=pd_nn&controller.kv_Nms_rad=80&seed=2")
    page.keyboard.press(".")
    slider = page.get_by_role("slider", name="controller.lam_per_s")
    slider.focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#answer")).to_contain_text("from cycle 1 on")
    said = run_to_the_end(page)
    assert said.startswith("digest ") and "prints the same" in said
    words = shlex.split(page.locator("#command").inner_text())
    assert words[:3] == ["pcpc", "simulate", "hull"]
    settings = [text for flag, text in pairwise(words) if flag == "--set"]
    assert len(settings) == 3 and "duration_s=2" in settings, words
    rig = load_rig(Path(find("hull")), words[words.index("--controller") + 1], settings)
    assert said.split()[1].rstrip(";") == digest(Program(rig), in_memory(rig))[:16]


def test_settings_of_a_link_that_are_wrong_are_told_and_left_out(page: Page, file: Path) -> None:
    wrong = "#controller=nobody&seed=99&controller.kv_Nms_rad=1e9&x=<img src=x onerror=alert(1)>"
    opened(page, file, wrong)
    told = page.locator("#notice").inner_text().splitlines()
    assert len(told) == 5 and "nobody" in told[1] and told[3].startswith("x: no such"), told
    assert page.locator("img").count() == 0
    assert EQUAL.fullmatch(run_to_the_end(page))


def test_a_changed_run_is_judged_as_the_command_that_is_shown(page: Page, tmp_path: Path) -> None:
    file = made(tmp_path, "hull", "--controller", "pd")
    for changed in ("kv_Nms_rad=97", "gear_ratio=50"):
        opened(page, file, f"#controller=pd&controller.{changed}")
        run_to_the_end(page)
        words = shlex.split(page.locator("#command").inner_text())
        assert words.pop() == "--digest"  # a line of its own, which JSON has no room for
        done = pcpc(*words[1:], "--json", "--no-figure", "-o", str(tmp_path / changed))
        native = json.loads(done.out)
        state = f"{native['verdict']}, {len(native['judged'])} judged"
        expect(page.locator("#state")).to_have_text(state)
        rows = [row.split("\t") for row in page.locator("#metrics").inner_text().splitlines()]
        left = [row[1] for row in rows if row[2].endswith("gear_ratio was changed")]
        told = {row[1]: row[2] for row in rows if row[1] not in left}
        assert told == {n: f"{x:.4g}" for n, x in native["metrics"].items() if n not in left}
        assert (done.code, len(left)) == ((1, 0) if changed[0] == "k" else (0, 2)), done


def test_a_link_that_follows_another_takes_nothing_from_it(page: Page, file: Path) -> None:
    opened(page, file, "#controller=pd&seed=2&controller.lam_per_s=4")
    assert run_to_the_end(page).startswith("digest ")
    opened(page, file, "#controller=pd")
    expect(page.locator("#seed")).to_have_value("1")
    assert EQUAL.fullmatch(run_to_the_end(page))


def test_a_link_of_any_length_is_told_in_a_few_lines(page: Page, file: Path) -> None:
    opened(page, file, "#" + "&".join(["x" * 100_000, *(f"a{i}=1" for i in range(2000))]))
    told = page.locator("#notice").inner_text()
    assert len(told) < 1000 and told.endswith("\nand 1990 more"), told
    assert EQUAL.fullmatch(run_to_the_end(page))


def test_a_run_keeps_time_steps_and_begins_anew_from_the_keyboard(page: Page, file: Path) -> None:
    opened(page, file)
    page.keyboard.press(">")
    expect(page.locator("#clock")).to_have_text("0.100 s of 2.000 s")
    page.keyboard.press(".")
    expect(page.locator("#clock")).to_have_text("0.101 s of 2.000 s")
    page.keyboard.press(" ")
    expect(page.locator("#state")).to_have_text("running")
    page.keyboard.press(" ")
    expect(page.locator("#state")).to_have_text("paused")
    page.locator("#again").click()
    expect(page.locator("#clock")).to_have_text("0.000 s of 2.000 s")


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_wider_than_the_window(
    browser: Browser, file: Path, width: int, scheme: str
) -> None:
    own = browser.new_context(
        viewport={"width": width, "height": 900},
        color_scheme="dark" if scheme == "dark" else "light",
        reduced_motion="reduce",
    )
    tab = own.new_page()
    opened(tab, file)
    assert EQUAL.fullmatch(run_to_the_end(tab))
    wide = tab.locator("html").evaluate("(html) => html.scrollWidth")
    named = "(all) => all.every((one) => one.labels?.length || one.ariaLabel || one.textContent)"
    assert wide <= width
    assert tab.locator("button, select, input").evaluate_all(named)
    own.close()


@pytest.mark.parametrize("part", [0.05, 0.5, 0.9, 0.97])
def test_a_damaged_file_says_so(page: Page, file: Path, tmp_path: Path, part: float) -> None:
    """A letter is another: also where the packed data can be unpacked all the same."""
    text = file.read_text("utf-8")
    begin = text.index('id="payload">') + 13
    at = begin + round(part * (text.index("</script>", begin) - begin))
    damaged = tmp_path / "page.html"
    damaged.write_text(text[:at] + ("B" if text[at] == "A" else "A") + text[at + 1 :], "utf-8")
    page.goto(f"file://{damaged}")
    expect(page.locator("#notice")).to_contain_text("damaged", timeout=LATER)


def test_a_run_that_was_left_has_no_part_in_the_next(page: Page, file: Path) -> None:
    """Restarts in the middle, as fast as a page can ask for them."""
    opened(page, file)
    page.select_option("#speed", "Infinity")
    again = "document.getElementById('again').click()"
    often = f"(go) => {{ for (let i = 0; i < 30; i++) {{ go.click(); {again}; }} }}"
    page.locator("#go").evaluate(often)
    assert EQUAL.fullmatch(run_to_the_end(page))


def test_a_log_that_is_saved_replays_and_plays(page: Page, file: Path, tmp_path: Path) -> None:
    opened(page, file, "#controller=pd_nn&controller.kv_Nms_rad=80")
    page.keyboard.press(".")
    page.get_by_role("slider", name="controller.lam_per_s").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#answer")).to_contain_text("from cycle 1 on")
    page.get_by_role("button", name="fire now").press("Enter")
    expect(page.locator("#answer")).to_contain_text("fire_hub_start_s = 0.002")
    expect(page.locator("#command")).to_contain_text("in no command")
    run_to_the_end(page)
    with page.expect_download() as saved:
        page.locator("#save").click()
    log = tmp_path / "page.mcap"
    saved.value.save_as(log)
    done = pcpc("replay", str(log), "--json")
    assert done.code == 0 and all(one["identical"] for one in json.loads(done.out)), done
    page.set_input_files("#open", log)
    expect(page.locator("#state")).to_have_text("end of the log", timeout=LATER)
    for damaged, what in ((log.read_bytes()[:-99], "damaged"), (b"%PDF-1.7", "no MCAP file")):
        page.set_input_files("#open", {"name": "x", "mimeType": "", "buffer": damaged})
        expect(page.locator("#notice")).to_contain_text(what)
