"""`pcpc compare A B`: what two runs, or two folders of runs, differ in."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_schemas import holds
from logcommand import Done, run_here

import pcpc
from pcpc.executive.log import reader as logs
from pcpc.tools.after.compare.comparison import Comparison
from pcpc.tools.after.compare.pair import ALONE, CHANGED, EQUAL, FAILED, UNCHANGED, Pair
from pcpc.tools.after.differences import Change
from pcpc.tools.after.verdict import summary_file
from pcpc.tools.start.folder import LOG

SHORT = {"duration_s": 0.4, "evaluation.window_s": [0.0, 0.4]}
HELD = {"name": "held", "always": "abs(controller.e_rad) < 9"}
FAR = {"name": "far", "always": "controller.e_rad < 9", "after": "1s"}
GAIN = {"controller.kv_Nms_rad": 111.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with runs of the barrel: gain, plant, nothing changed."""
    folder = tmp_path_factory.mktemp("compare")
    runs: dict[str, tuple[str, str, dict[str, Any]]] = {
        "old/gain": ("slew10", "pd", {}), "new/gain": ("slew10", "pd", GAIN),
        "old/plant": ("hull", "pd", {}), "new/plant": ("hull", "pd", {"barrel.gap_rad": 0.003}),
        "old/same": ("sin0.5", "pid", {}), "new/same": ("sin0.5", "pid", {}),
        "new/only": ("sin0.5", "pd", {}),
    }  # fmt: skip
    for name, (rig, controller, changes) in runs.items():
        pcpc.simulate(rig, controller, set=SHORT | changes, folder=folder / name, quiet=True)
    return folder


def compared(*words: str | Path, code: int) -> Done:
    done = run_here("compare", *words, "--quiet")
    assert done.code == code, done
    assert [line for line in done.out.splitlines() if len(line) > 80] == [] or "-" in words, done
    return done


def test_a_comparison_that_is_refused_leaves_no_folder(tmp_path: Path) -> None:
    compared("one", "-o", tmp_path / "figures", code=2)
    assert not list(tmp_path.iterdir())


def pairs(*words: str | Path, code: int) -> dict[str, Any]:
    """Return the pairs that `--json` tells, by rig."""
    told = holds("compare", compared(*words, "--json", "-", code=code).out)
    assert told["changed"] is any(pair["state"] != "equal" for pair in told["pairs"])
    return {f"{pair['rig']}/{pair['controller']}": pair for pair in told["pairs"]}


def test_the_same_run_again_is_equal_to_the_bit(folder: Path) -> None:
    out = compared(folder / "old/same", folder / "new/same", code=0).out
    told = "sin0.5, pid: equal to the bit, cycles of executive 400 of 400, plant 401 of 401"
    assert told in " ".join(out.split()) and ": 1 equal\n" in out, out


def test_a_changed_gain_is_named_with_cycle_signal_and_metrics(folder: Path) -> None:
    pair = pairs(folder / "old/gain", folder / "new/gain", code=1)["slew10/pd"]
    first, old, new = (
        pair["first"],
        *(
            logs.read(folder / side / "gain" / LOG).node["executive"].columns
            for side in ("old", "new")
        ),
    )
    name = first["name"]
    assert name == "controller.motor_torque_Nm", "the law comes before the frame it goes into"
    assert first["cycle"] == int(np.flatnonzero(old[name] != new[name])[0])
    assert pair["settings"] == [
        {"name": "controllers.pd.parameters.kv_Nms_rad", "old": 110.0, "new": 111.0}
    ]
    told = {metric["name"]: metric for metric in pair["metrics"]}
    for side in ("old", "new"):
        metrics = json.loads((folder / side / "gain/summary.json").read_text())["metrics"]
        assert {name: metric[side] for name, metric in told.items()} == metrics
    largest = {signal["name"]: signal["largest"] for signal in pair["signals"]}
    assert largest[name] == np.abs(old[name] - new[name]).max()
    text = compared(folder / "old/gain", folder / "new/gain", code=1).out
    assert "slew10, pd: differs from cycle 0 (0.000 s) on" in text
    assert re.search(r"muzzle_error_rms_mrad +\S+ +-> +\S+ +[+-][\d.]+ %", text), text


def test_a_changed_plant_is_seen_in_the_plant_first(folder: Path) -> None:
    pair = pairs(folder / "old/plant", folder / "new/plant", code=1)["hull/pd"]
    assert pair["first"]["name"].startswith("plant.barrel."), pair["first"]
    assert [one["name"] for one in pair["settings"]] == ["plant.blocks.barrel.parameters.gap_rad"]


def test_folders_are_compared_rig_by_rig_and_what_has_no_partner_is_named(folder: Path) -> None:
    found = pairs(folder / "old", folder / "new", code=1)
    states = {name: pair["state"] for name, pair in found.items()}
    assert states == {
        "hull/pd": "changed", "sin0.5/pd": "alone", "sin0.5/pid": "equal", "slew10/pd": "changed",
    }  # fmt: skip
    alone, verdict, why = found["sin0.5/pd"]["said"]
    assert alone == f"only in new: {folder / 'new/only' / LOG}" and verdict == "verdict not judged"
    assert why == "evaluation.window_s was changed: the limits are for another window"
    text = compared(folder / "old", folder / "new", code=1).out
    assert "2 changed, 1 equal, 1 on one side only" in " ".join(text.split())


def test_the_table_for_a_pull_request_is_markdown(folder: Path) -> None:
    lines = compared(folder / "old", folder / "new", "--markdown", "-", code=1).out.splitlines()
    assert lines[0].startswith("### pcpc compare: 2 changed, 1 equal")
    rows = [line for line in lines if line.startswith("|")]
    assert len(rows) > 4 and {row.count(" |") for row in rows} == {6}, rows
    assert any(row.startswith("| hull, pd | from cycle") for row in rows), rows
    assert "<details><summary>1 equal to the bit</summary>" in lines


def test_figures_lay_new_over_old(folder: Path, tmp_path: Path) -> None:
    compared(folder / "old", folder / "new", "-o", tmp_path / "out", code=1)
    report = (tmp_path / "out/report.md").read_text()
    drawn = re.findall(r"!\[.*?\]\((.*?)\)", report)
    assert drawn == ["hull-pd.png", "slew10-pd.png"], report
    assert all((tmp_path / "out" / name).read_bytes().startswith(b"\x89PNG") for name in drawn)
    done = compared(folder / "old", folder / "new", "-o", tmp_path / "out", code=2)
    assert done.err == f"{tmp_path / 'out'}: is not empty; choose another folder with -o\n"


def test_a_verdict_that_changed_says_why(folder: Path, tmp_path: Path) -> None:
    limits = {"good": 1e9, "bad": 1e-9}
    for name, limit in limits.items():
        changes = {"expect.pd.muzzle_error_rms_mrad": [0.0, limit]}
        pcpc.simulate("slew10", "pd", set=changes, folder=tmp_path / name, quiet=True)
    words = (tmp_path / "good", tmp_path / "bad")
    text = compared(*words, code=1).out
    assert "differs in no recorded signal" in text and "verdict  ok -> expectation not met" in text
    assert "new: muzzle_error_rms_mrad = " in text and "expected 0 to 1e-09" in text, text
    compared(*words, "--fail-on", "verdict", code=1)


@pytest.mark.parametrize(
    ("before", "now", "code", "said"),
    [
        ({}, {}, 0, ""),
        ({}, SHORT, 1, "ok -> not judged"), (SHORT, {}, 1, "not judged -> ok"),
        (SHORT, SHORT, 1, "new: muzzle_error_rms_mrad was not judged: evaluation.window_s was"),
        (SHORT | {"require": [HELD]}, SHORT | {"require": [HELD, FAR]}, 1, "new: far was not"),
        (SHORT | {"require": [HELD, FAR]}, SHORT | {"require": [HELD, FAR]}, 0, ""),
    ],
)  # fmt: skip
@pytest.mark.quick
def test_a_gate_for_verdicts_passes_no_run_that_was_not_judged(
    before: dict[str, Any], now: dict[str, Any], code: int, said: str, tmp_path: Path
) -> None:
    loose = {"expect.pd.muzzle_error_rms_mrad": [0.0, 1e9]}
    for name, changes in (("old", before), ("new", now | GAIN)):
        pcpc.simulate("slew10", "pd", set=loose | changes, folder=tmp_path / name, quiet=True)
    words = tmp_path / "old", tmp_path / "new", "--fail-on", "verdict"
    text = " ".join(compared(*words, code=code).out.split())
    assert said in text and text.count("was not judged") == ("new: " in said or now == SHORT), text


def test_what_cannot_be_compared_does_not_pass_for_equal(folder: Path, tmp_path: Path) -> None:
    for side in ("old", "new"):
        shutil.copytree(folder / side / "gain", tmp_path / side)
    file = tmp_path / "new" / summary_file.NAME
    file.write_text(file.read_text().replace('"late_cycles": 0', '"late_cycles": 1'))
    words = tmp_path / "old", tmp_path / "new", "--fail-on"
    out = compared(*words, "verdict", code=1).out
    what = f"no verdict: {tmp_path}/new/log.mcap: no summary.json of this run is beside it"
    assert what.replace(" ", "") in "".join(out.split()), out
    compared(*words, "metrics", "--tolerance", "1e9", code=1)
    compared(*words, "never", code=0)
    file.unlink()
    compared(*words, "metrics", "--tolerance", "1e9", code=0)
    compared(*words, "verdict", code=1)
    compared(tmp_path / "new", tmp_path / "new", "--fail-on", "verdict", code=0)


def test_a_run_that_nobody_can_judge_here_has_no_equal_metrics() -> None:
    pair = Pair("rig", "pd", CHANGED, unknown=["metrics"])
    fails = {on: Comparison("a", "b", [pair]).fails(on) for on in ("any", "metrics", "verdict")}
    assert fails == {"any": True, "metrics": True, "verdict": False}


A_METRIC, A_VERDICT = [Change("m", 1.0, 2.0)], Change("verdict", "ok", "loss")


@pytest.mark.parametrize(
    ("states", "fails"),
    [
        ([], "any metrics verdict"), ([{}], ""), ([{"state": UNCHANGED}], ""),
        ([{}, {"state": ALONE}], "any metrics verdict"),
        ([{}, {"state": ALONE, "allowed": True}], ""),
        ([{}, {"state": ALONE, "allowed": True}, {"state": ALONE}], "any metrics verdict"),
        ([{"state": ALONE, "allowed": True}], "any metrics verdict"),
        ([{}, {"state": FAILED}], "any metrics verdict"),
        ([{}, {"unknown": ["verdict"]}], "verdict"),
        ([{}, {"unknown": ["metrics"]}], "metrics"), ([{}, {"state": CHANGED}], "any"),
        ([{"state": CHANGED, "metrics": A_METRIC}], "any metrics"),
        ([{}, {"state": CHANGED, "verdict": A_VERDICT}], "any metrics verdict"),
    ],
)  # fmt: skip
def test_a_gate_is_failed_by_what_it_names_and_by_what_is_not_compared(
    states: list[dict[str, Any]], fails: str
) -> None:
    found = Comparison("a", "b", [Pair("rig", "pd", **{"state": EQUAL} | one) for one in states])
    assert " ".join(on for on in ("any", "metrics", "verdict") if found.fails(on)) == fails
    assert not found.fails("never")


def test_where_nothing_has_a_partner_nothing_is_equal(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "old/gain", tmp_path / "old/gain")
    shutil.copytree(folder / "new/same", tmp_path / "new/same")
    for on, code in (("any", 1), ("metrics", 1), ("verdict", 1), ("never", 0)):
        compared(tmp_path / "old", tmp_path / "new", "--fail-on", on, code=code)


def test_margins_of_requirements_in_time_count_as_metrics(folder: Path, tmp_path: Path) -> None:
    for side, margin in (("old", 0.25), ("new", -0.5)):
        shutil.copytree(folder / "old/same", tmp_path / side)
        file = tmp_path / side / "summary.json"
        told = json.loads(file.read_text())
        told["requirements"] = [{"name": "calm", "held": margin > 0.0, "margin": margin}]
        summary_file.write_json(summary_file.from_json(told), file)
    text = compared(tmp_path / "old", tmp_path / "new", code=1).out
    assert re.search(r"metrics +margin of calm +0\.25 +-> +-0\.5 +-300\.0 %", text), text


@pytest.mark.parametrize("name", ["e_rad", "error_of_the_first_joint_rms_rad", "n" * 100])
def test_metrics_of_any_length_fit_the_terminal_and_show_where_they_differ(name: str) -> None:
    metrics = [Change(name, 1.0000000000000002e-10, 1.0000000000000004e-10), Change("b", 1.0, 2.0)]
    text = Comparison("old", "new", [Pair("rig", "pd", CHANGED, metrics=metrics)]).text()
    assert [line for line in text.splitlines() if len(line) > 80] == [], text
    words = " ".join(text.split())
    assert "1.0000000000000002e-10 -> 1.0000000000000004e-10" in words, text
    assert "b 1 -> 2 +100.0 %" in words, text


def test_a_tolerance_is_of_metrics_and_never_of_bits(folder: Path) -> None:
    words = (folder / "old/plant", folder / "new/plant", "--tolerance")
    for tolerance, code in (("1e-20", 1), ("1e9", 0)):
        compared(*words, tolerance, "--fail-on", "metrics", code=code)
    changes = [Change(**one) for one in pairs(*words, "0", code=1)["hull/pd"]["metrics"]]
    largest = max(abs(one.relative) for one in changes if one.differs)
    compared(*words, repr(largest), "--fail-on", "metrics", code=0)
    pair = pairs(*words, "1e9", code=1)["hull/pd"]
    assert pair["state"] == "changed" and pair["first"], pair


def test_a_log_alone_is_judged_by_what_it_carries(folder: Path, tmp_path: Path) -> None:
    moved = shutil.copy(folder / "new/gain" / LOG, tmp_path / "moved.mcap")
    assert compared(folder / "new/gain", moved, code=0)


def test_from_python_it_is_an_object(folder: Path) -> None:
    runs = [pcpc.open(folder / side / "gain") for side in ("old", "new")]
    for found in (pcpc.compare(*runs), pcpc.compare(folder / "old/gain", runs[1])):
        (pair,) = found.pairs
        assert found.changed and pair.first is not None and pair.first.cycle == 0
        assert pair.changed_metrics[0].name in runs[0].metrics
        assert "slew10, pd" in found.markdown() and "slew10, pd" in found.text()
    assert not pcpc.compare(runs[0], runs[0]).changed
    with pytest.raises(pcpc.Error, match="no log in this folder"):
        pcpc.compare(folder / "old", Path(__file__).parent)
