"""`pcpc report --suite`: what it says of many runs, and that nothing makes it say ok falsely."""

import json
import os
import shutil
from pathlib import Path
from xml.etree import ElementTree

import pytest
from html_page import Page
from logcommand import Done, run_here
from processes import RIGS

import pcpc
from pcpc.executive.errors import RigError
from pcpc.executive.nodes.virtual import simulate as bare
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict import summary_file

HOLDS = "{id: R-1, never: abs(controller.e_rad) > 1000}"
LIMIT = "{muzzle_error_rms_mrad: {low: 0, high: 1000, id: R-2}}"


def made(folder: Path, require: str = HOLDS, limit: str = LIMIT, *words: str) -> Path:
    """Run 0.2 s of the step of 10 deg into `folder`."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    rig = folder.parent / f"{folder.name}.yaml"
    rig.write_text(
        f"base: {RIGS / 'step10.yaml'}\nduration_s: 0.2\nevaluation: {{window_s: [0, 0.2]}}\n"
        f"require: [{require}]\nexpect: {{pd: {limit}}}\n"
    )
    done = run_here("simulate", rig, "-o", folder, "--no-figure", "--quiet", *words)
    assert (folder / "log.mcap").exists(), done.err
    return folder


def suite(folder: Path, *words: str | Path) -> Done:
    """Return what the suite of the runs below a folder comes to."""
    out = folder / "suite.html"
    words = words or (folder,)
    return run_here("report", "--suite", *words, "-o", out, "--junit", folder / "suite.xml")


def cases(folder: Path) -> dict[str, str]:
    """Return the failure's type of each test case, "" for none; the counts are right."""
    top = ElementTree.parse(folder / "suite.xml").getroot()
    assert top.tag == "testsuites"
    found = {}
    for one in top:
        own = one.findall("testcase")
        assert one.get("tests") == str(len(own))
        assert one.get("failures") == str(len(one.findall("testcase/failure")))
        assert one.get("errors") == str(len(one.findall("testcase/error")))
        for case in own:
            assert case.get("classname") and case.get("name") and case.get("time") == "0"
            wrong = next((x for x in case if x.tag in ("failure", "error")), None)
            found[str(case.get("name"))] = "" if wrong is None else str(wrong.get("type"))
    assert top.get("tests") == str(len(found))
    return found


def test_all_that_holds_is_ok_with_margin_log_and_digest(tmp_path: Path) -> None:
    made(tmp_path / "runs/a <b>")
    done = suite(tmp_path)
    assert (done.code, done.out) == (0, f"{tmp_path / 'suite.html'}\n"), done
    assert set(cases(tmp_path).values()) == {""}
    page = Page(tmp_path / "suite.html")
    text = (tmp_path / "suite.html").read_text("utf-8")
    assert 'href="./runs/a%20%3Cb%3E/log.mcap"' in text and "Verdict: <b>ok</b>" in text
    assert page.tables and "R-1" in text and "R-2" in text
    asked = "report", "--suite", tmp_path, "-o", tmp_path / "s.html", "--need"
    assert [run_here(*asked, ids).code for ids in ("R-1,R-2", "R-1,R-3")] == [0, 1]


@pytest.mark.parametrize(
    ("require", "limit", "words", "verdicts"),
    [
        ("{id: R-1, never: abs(controller.e_rad) >= 0}", LIMIT, (), {"R-1": "violated"}),
        ("{id: R-1, when: controller.e_rad > 1000, then: time.t_s > 0}", LIMIT, (),
         {"R-1": "never happened"}),
        ("{id: R-1, when: time.t_s > 9, then: time.t_s > 0}", LIMIT, (), {"R-1": "not judged"}),
        ("{id: R-1, always: time.t_s >= 0, after: 9s}", LIMIT, (), {"R-1": "not judged"}),
        (HOLDS, "{muzzle_error_rms_mrad: {high: -1, id: R-2}}", (), {"R-2": "violated"}),
        (HOLDS, LIMIT, ("--set", "duration_s=0.1"), {"R-2": "not judged"}),
    ],
)  # fmt: skip
def test_what_does_not_hold_is_told(
    tmp_path: Path, require: str, limit: str, words: tuple[str, ...], verdicts: dict[str, str]
) -> None:
    made(tmp_path / "a", require, limit, *words)
    assert suite(tmp_path).code == 1
    found = cases(tmp_path)
    told = {
        key: word
        for key in ("R-1", "R-2")
        for name, word in found.items()
        if name.startswith(key) and word
    }
    assert told == verdicts, found


# ------------------------------------------------------------------------------- ok, falsely?


def test_a_run_with_two_names_is_one_run(tmp_path: Path) -> None:
    run = made(tmp_path / "a")
    (tmp_path / "link").symlink_to(run)
    assert suite(tmp_path, run, tmp_path / "link", tmp_path / "a/../a").code == 0
    text = (tmp_path / "suite.xml").read_text("utf-8")
    assert (text.count("R-1"), text.count("R-2")) == (1, 1), text


def test_words_that_begin_alike_are_not_one_limit_or_one_id(tmp_path: Path) -> None:
    rest = "{name: muzzle_error_rms_mrad at rest, always: time.t_s < 0.1}"
    soon = "{id: R, name: Reached soon, never: abs(controller.e_rad) > 1000}"
    limit = "{muzzle_error_rms_mrad: [0, 1000]}"
    log = made(tmp_path / "a", f"{rest}, {soon}", limit) / "log.mcap"
    assert suite(tmp_path).code == 1
    assert cases(tmp_path) == {
        "muzzle_error_rms_mrad at rest": "violated",
        "R Reached soon": "",
        "muzzle_error_rms_mrad 0 to 1000": "",
        str(log): "expectation not met",
    }


def test_a_run_that_nothing_judged_is_not_judged_anywhere(tmp_path: Path) -> None:
    late = "{id: R-1, always: time.t_s >= 0, after: 9s}"
    folder = made(tmp_path / "a", late, LIMIT, "--set", "duration_s=0.1")
    done = suite(tmp_path)
    why = "the run ends at 0.1 s, before its window ends at 5 s; duration_s=5 is enough"
    assert done.code == 1 and why in " ".join(done.out.split()), done
    assert set(cases(tmp_path).values()) == {"not judged"}
    assert why in (tmp_path / "suite.xml").read_text("utf-8")
    run_here("report", folder, "-o", tmp_path / "r.html", "--quiet")
    text = (tmp_path / "r.html").read_text("utf-8")
    assert "Verdict: <b>not judged</b>" in text and 'class="verdict ok"' not in text
    assert text.count(f"<li>R-2 muzzle_error_rms_mrad was not judged: {why}</li>") == 1
    summary = summary_file.summary_beside(folder / "log.mcap")
    assert summary is not None and summary.reasons() == summary.problems(), summary
    assert summary.reasons() == [why, "the run ended before its time began, at 9.0 s"]
    with pytest.raises(pcpc.NotOk, match=f"step10: not judged: {why}; the run ended"):
        pcpc.open(folder).check()
    assert f"<li>{why}</li>" not in text, "told once, with the name"
    alone = made(tmp_path / "b/c", late, "{muzzle_error_rms_mrad: null}")
    (alone / "summary.json").unlink()
    assert suite(tmp_path, alone).code == 1
    assert cases(tmp_path)[str(alone / "log.mcap")] == "loss"
    (folder / "summary.json").unlink()
    assert pcpc.open(folder).verdict == "not judged", "nobody knows that duration_s was changed"


def test_the_worst_of_two_runs_counts_whichever_is_later(tmp_path: Path) -> None:
    for first, second in (("a", "b"), ("b", "a")):
        folder = tmp_path / first
        made(folder / first)
        made(folder / second, HOLDS, LIMIT, "--set", "duration_s=0.1")
        assert suite(folder).code == 1
        assert "not judged" in cases(folder).values()


def test_a_requirement_that_was_deleted_is_not_judged_any_more(tmp_path: Path) -> None:
    made(tmp_path / "a")
    made(tmp_path / "b", "{id: R-9, never: abs(controller.e_rad) > 1000}")
    done = suite(tmp_path)
    assert done.code == 1 and "a later run of this rig does not test it any more" in done.out
    done = run_here(
        "report", "--suite", tmp_path / "b", "-o", tmp_path / "s.html", "--need", "R-9,R-1"
    )
    assert done.code == 1 and "R-1: not judged: no run tests it" in done.out


def test_a_requirement_is_not_deleted_by_an_earlier_run_or_one_of_another_controller(
    tmp_path: Path,
) -> None:
    made(tmp_path / "a", "{id: R-9, never: abs(controller.e_rad) > 1000}")
    made(tmp_path / "b", f"{HOLDS}, {{id: R-9, never: abs(controller.e_rad) > 1000}}")
    assert suite(tmp_path).code == 0
    made(tmp_path / "c", "", LIMIT, "--controller", "pid")
    suite(tmp_path)
    assert not any(word for name, word in cases(tmp_path).items() if name.startswith("R-"))


def test_a_limit_that_a_change_left_out_costs_the_run_nothing(tmp_path: Path) -> None:
    limit, window = "{muzzle_error_rms_mrad: {high: -1, id: R-2}}", "evaluation.window_s=[0.0, 0.1]"
    log = made(tmp_path / "a", HOLDS, limit, "--set", window) / "log.mcap"
    assert suite(tmp_path).code == 1
    found = cases(tmp_path)
    assert {found.pop(name) for name in [*found] if name.startswith("R-2")} == {"not judged"}
    assert found.get(str(log), "") == "", found


@pytest.mark.parametrize(
    ("own", "verdict"),
    [
        ({"verdict": "interrupted"}, "interrupted"),
        ({"lost": ["3 frames"]}, "loss"),
        ({"frames_too_many": ["9 frames"], "faults": ["it broke"]}, "safety stop"),
        ({"verdict": "not judged"}, "not judged"),
    ],
)
def test_what_its_own_summary_says_against_a_run_counts(
    own: dict[str, str | list[str]], verdict: str, tmp_path: Path
) -> None:
    log = made(tmp_path / "a") / "log.mcap"
    summary = json.loads((tmp_path / "a/summary.json").read_text("utf-8")) | own
    summary_file.write_json(summary_file.from_json(summary), log.with_name("summary.json"))
    done = suite(tmp_path)
    assert done.code == (3 if verdict == "loss" else 1)
    assert cases(tmp_path)[str(log)] == verdict
    for lines in own.values():
        assert all(done.out.count(one) == 1 for one in lines if isinstance(lines, list))


def test_a_log_changed_after_the_run_is_not_ok(tmp_path: Path) -> None:
    folder, other = made(tmp_path / "runs/a"), made(tmp_path / "b")
    shutil.copy(other / "log.mcap", folder / "log.mcap")
    assert suite(tmp_path, tmp_path / "runs").code == 1 or "changed since" in (
        tmp_path / "suite.html"
    ).read_text("utf-8")
    with (folder / "log.mcap").open("ab") as file:
        file.write(b"x")
    done = suite(tmp_path, tmp_path / "runs")
    assert done.code in (1, 3) and "changed since" in done.out, done


def test_a_summary_that_says_ok_does_not_help_a_log_that_does_not(tmp_path: Path) -> None:
    folder = made(tmp_path / "a", "{id: R-1, never: abs(controller.e_rad) >= 0}")
    told = json.loads((folder / "summary.json").read_text("utf-8"))
    told |= {"verdict": "ok", "expectations_failed": [], "requirements": []}
    del told["bound"]
    summary_file.write_json(summary_file.from_json(told), folder / "summary.json")  # sealed anew
    done = suite(tmp_path)
    assert done.code == 1 and "summary.json says ok, the log does not" in done.out
    assert "violated" in cases(tmp_path).values()


@pytest.mark.parametrize("how", ["no log", "empty", "text", "cut"])
def test_a_run_without_a_whole_log_is_told(tmp_path: Path, how: str) -> None:
    made(tmp_path / "a")
    log = made(tmp_path / "b") / "log.mcap"
    content = log.read_bytes()
    log.write_bytes({"cut": content[: len(content) // 2], "text": b"no log"}.get(how, b""))
    if how == "no log":
        log.unlink()
    done = suite(tmp_path)
    assert done.code in (1, 3) and str(log) in done.out, done
    assert cases(tmp_path)[str(log)], done


def test_a_run_with_nothing_to_judge_is_not_ok(tmp_path: Path) -> None:
    made(tmp_path / "a", "", "null")
    done = suite(tmp_path)
    assert done.code == 1 and "nothing to judge" in done.out and "nothing was judged" in done.out


def test_a_bare_log_is_judged_and_says_so(tmp_path: Path) -> None:
    made(tmp_path / "a")
    rig = load_rig(tmp_path / "a.yaml")
    bare(rig, tmp_path / "bare.mcap")
    done = suite(tmp_path, tmp_path / "bare.mcap")
    assert done.code == 0 and "bare.mcap: judged from the log alone" in done.out, done
    assert "judged from the log alone" in (tmp_path / "suite.html").read_text("utf-8")


def test_a_run_folder_without_a_summary_is_not_ok(tmp_path: Path) -> None:
    (made(tmp_path / "a") / "summary.json").unlink()
    done = suite(tmp_path)
    assert done.code == 3 and "a/log.mcap: loss: no summary.json: how the run ended" in done.out
    assert cases(tmp_path)[str(tmp_path / "a/log.mcap")] == "loss"
    made(tmp_path / "b", HOLDS, "{muzzle_error_rms_mrad: {high: -1, id: R-2}}")
    assert suite(tmp_path).code == 1, "what is violated goes before what is missing"
    (tmp_path / "b/summary.json").unlink()
    assert suite(tmp_path).code == 1
    assert cases(tmp_path)[str(tmp_path / "b/log.mcap")] == "expectation not met"


def test_a_run_whose_evaluation_is_not_run_here_keeps_what_it_tests(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text((RIGS.parent / "evaluation.py").read_text())
    words = "--set", f"evaluation.file={own}"
    log = made(tmp_path / "a", f"{HOLDS}, {{never: time.t_s > 9}}", LIMIT, *words) / "log.mcap"
    found = []
    for text in ("", "# is another one\n"):
        with own.open("a") as file:
            file.write(text)
        assert suite(tmp_path).code == 1
        found.append({name: word for name, word in cases(tmp_path).items() if name != str(log)})
    assert found[0].keys() == found[1].keys() and len(found[0]) == 3, found
    assert {*found[1].values()} == {"not judged"} and "" in found[0].values()


def test_a_pipe_in_place_of_a_log_is_no_log_and_ends(tmp_path: Path) -> None:
    (made(tmp_path / "a") / "log.mcap").unlink()
    os.mkfifo(tmp_path / "a/log.mcap")
    done = suite(tmp_path)
    assert done.code == 1 and "a/log.mcap: no log" in done.out, done


def test_a_loop_of_links_is_a_line(tmp_path: Path) -> None:
    made(tmp_path / "a")
    for name, to in (("b", "c"), ("c", "b"), ("run/log.mcap", "log.mcap")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).symlink_to(to)
    done = suite(tmp_path)
    assert done.code == 3 and "run/log.mcap: no log: Too many levels of symbolic links" in done.out


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("--suite", "EMPTY"), "no run below this folder"),
        (("--suite", "EMPTY/none"), "no such log"),
        (("--suite", ""), "an empty name"),
        (("--suite",), "expected at least one argument"),
        (("LOG", "--suite", "EMPTY"), "after --suite"),
        (("LOG", "--junit", "a.xml"), "only with several runs"),
        (("LOG", "--need", "R"), "only with several runs"),
        ((), "no log"),
        (("--suite", "RUN", "-o", "EMPTY/a.txt"), "expected FILE.html"),
        (("--suite", "RUN", "-o", "EMPTY/no/a.html"), "there is no folder"),
        (("--suite", "RUN", "-o", "EMPTY/a.html", "--junit", "EMPTY"), "is a folder"),
        (("--suite", "RUN", "-o", "EMPTY/a.html", "--junit", "EMPTY/a.html"), "is the page"),
        (("--suite", "RUN", "-o", "EMPTY/a.html", "--need", "R,"), "an empty name"),
    ],
)
def test_wrong_input_is_refused(
    tmp_path: Path, words: tuple[str, ...], what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    places = {"EMPTY": str(tmp_path / "empty"), "RUN": str(tmp_path / "run"), "LOG": "x.mcap"}
    if "RUN" in words:
        (tmp_path / "run").mkdir()
        (tmp_path / "run/log.mcap").touch()
    given = []
    for word in words:
        for name, place in places.items():
            word = word.replace(name, place)
        given.append(word)
    try:
        done = run_here("report", *given)
        code, err = done.code, done.err
    except SystemExit as error:
        code, err = int(str(error.code)), capsys.readouterr().err
    except RigError as error:
        code, err = 2, str(error)
    assert code == 2 and what in err, (code, err)
    assert not [*tmp_path.rglob("*.html")]
