"""Requirements of a rig in its runs: the verdict, the exact cycle in every pacing, the figure."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from logcommand import barrel_log, run_here
from processes import PATIENT, RIGS, own_bus, pcpc

from pcpc import Error, NotOk, Run, open, simulate
from pcpc.executive.errors import RigError
from pcpc.executive.log import long_logs
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import load_rig
from pcpc.plants import pages
from pcpc.tools.after.verdict import report
from pcpc.tools.after.verdict.judge import Judge, check
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.after.verdict.requirements import JudgedRequirement
from pcpc.tools.after.verdict.summary import summarise

STEP10 = RIGS / "step10.yaml"
PAST = "never: abs(controller.e_rad) > 100 mrad"  # the step of cycle 500 is one of 175 mrad
ALL = f"""\
  - {{{PAST}, name: no large error}}
  - {{always: "abs(plant:barrel.theta_rad) < 1 rad and health.late_cycles < 1e9"}}
  - {{when: reference.q_d_rad changes, within: 50ms, then: abs(muzzle_error_rad) < 0.15, for: 20ms}}
  - {{settles: muzzle_error_rad, into: 3 mrad, when: reference.q_d_rad changes, within: 100ms}}
  - {{overshoot: "plant:barrel.theta_rad", over: reference.q_d_rad, at_most: 5 %}}
  - {{rate: controller.e_rad, at_most: 50 rad/s}}
  - {{always: abs(controller.e_rad) < 5 mrad, until: time.t_s > 0.495 s}}
"""


def rig_file(folder: Path, requirements: str, judged: str = "{window_s: [0.1, 0.7]}") -> Path:
    """Write the step of 10 deg, short, with other requirements."""
    path = folder / "rig.yaml"
    text = f"base: {STEP10}\nduration_s: 0.7\nevaluation: {judged}\nexpect: null\n"
    path.write_text(f"{text}require:\n{requirements}", "utf-8")
    return path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run that violates two of its requirements."""
    folder = tmp_path_factory.mktemp("run")
    return simulate(rig_file(folder, ALL), folder=folder / "run", quiet=True)


# ----------------------------------------------------------------------------------- the verdict


def test_a_violation_is_told_with_its_cycle_its_values_and_its_margin(run: Run) -> None:
    assert run.verdict == "expectation not met", run.summary
    first, *_ = run.summary["requirements"]
    assert (first["held"], first["first_cycle"], first["first_s"]) == (False, 500, 0.5), first
    e = np.abs(run["controller.e_rad"])
    assert first["value"] == e[500] and first["limit"] == 0.1 and first["unit"] == "rad"
    assert first["margin"] == 0.1 - e.max() and first["margin_cycle"] == e.argmax()
    said = [line for line in run.summary["expectations_failed"] if line.startswith("no large")]
    begin = (
        f"no large error: violated first at cycle 500, 0.5 s: abs(controller.e_rad) = {e[500]:.4g}"
    )
    assert said[0].startswith(f"{begin} rad, limit 0.1 rad, smallest margin"), said


def test_each_form_says_what_the_record_says(run: Run) -> None:
    e, muzzle = run["controller.e_rad"], np.abs(run["muzzle_error_rad"])
    theta, q_d = run["plant:barrel.theta_rad"], run["reference.q_d_rad"]
    _, always, then, settles, overshoot, rate, until = run.requirements
    assert always.held and always.margin == pytest.approx(1.0 - np.abs(theta).max())
    held = np.lib.stride_tricks.sliding_window_view(muzzle < 0.15, 21).all(axis=1)
    assert then.held == held[500:551].any(), then
    broken = 600 + int(np.argmax(muzzle[600:] > 3e-3))
    assert settles.first_cycle == broken and not settles.held, settles
    past = (theta - q_d)[500:].max()
    assert overshoot.held and overshoot.margin == pytest.approx(0.05 * q_d[-1] - past)
    assert rate.first_cycle == 500 and rate.what == "abs(rate(controller.e_rad))"
    assert rate.value == pytest.approx(abs(e[500] - e[499]) / 1e-3) and rate.unit == "rad/s"
    assert until.held and until.margin_cycle is not None and until.margin_cycle >= 496, until


def test_the_summary_fits_a_terminal_and_the_strict_verdict_knows_what_was_not_judged(
    run: Run, tmp_path: Path
) -> None:
    for label, lines in report.rows(run.result, Path("runs/x"), 80).items():
        assert all(len(line) <= 71 for line in lines), (label, lines)
    rig = load_rig(rig_file(tmp_path, "  - {when: 5s, then: controller.e_rad < 1}\n"))
    for strict, verdict in ((False, "not judged"), (True, "expectation not met")):
        found = summarise(rig, run.log, Outcome("virtual", "memory", strict=strict))
        assert found.verdict == verdict, found
        (why,) = found.not_judged.values()
        assert why == "the run ended before its time began, at 5.0 s", found


def test_requirements_are_those_of_the_controller(run: Run, tmp_path: Path) -> None:
    path = rig_file(tmp_path, f"  - {{{PAST}, controllers: [pid]}}\n")
    assert Judge.of(load_rig(path)).requirements(run.log) == []
    (found,) = Judge.of(load_rig(path, "pid")).requirements(run.log)
    assert found.first_cycle == 500


# ------------------------------------------------------------------------------------ any record


def same(found: list[JudgedRequirement], wanted: list[JudgedRequirement]) -> None:
    assert [one.json() for one in found] == [one.json() for one in wanted]


def test_equal_bits_have_equal_results_in_every_pacing(run: Run) -> None:
    for pacing in ("real", "sync", "lockstep", "virtual"):
        facts = {k: {**v, "pacing": pacing} for k, v in run.log.metadata.items()}
        log = dataclasses.replace(run.log, metadata=facts)
        same(run._judge.requirements(log), run.requirements)


@pytest.mark.parametrize("part", [7, 250, 600])
def test_a_long_log_has_the_results_of_a_short_one(run: Run, part: int) -> None:
    judge = run._judge
    long = long_logs.read(
        run.path, lambda log: judge.needed_columns(log, True), short=100, part=part
    )
    assert isinstance(long, long_logs.LongLog)
    same(judge.requirements(long), run.requirements)
    asked = judge.needed_columns(run.log, False)
    assert {"controller.e_rad", "health.late_cycles"} <= set(asked["executive"]) and (
        "barrel.theta_rad" in asked["plant"]
    ), asked


def rows_of(log: logs.Log, count: int, node: str) -> logs.Log:
    """Return a log with the first cycles of a node only."""
    one = log.node[node]
    columns, timing = ({k: v[:count] for k, v in of.items()} for of in (one.columns, one.timing))
    cut = dataclasses.replace(
        one, cycle=one.cycle[:count], stamp_ns=one.stamp_ns[:count], columns=columns, timing=timing
    )
    return dataclasses.replace(log, node=log.node | {node: cut})


def test_a_run_cut_short_is_judged_as_far_as_it_goes(run: Run) -> None:
    found = run._judge.requirements(rows_of(run.log, 520, "executive"))
    assert [one.held for one in found] == [False, None, None, None, None, False, True], found
    reasons = {one.reason for one in found if one.held is None}
    assert reasons == {"the run ended before its time was over"}


@pytest.mark.parametrize(
    ("pacing", "cycles", "open_at_its_end"),
    [("virtual", 700, False), ("virtual", 699, True), ("lockstep", 690, True),
     ("virtual", 380, True), ("real", 600, False), ("real", 599, True), ("sync", 400, True)],
)  # fmt: skip
def test_a_record_is_whole_to_its_last_cycle_and_on_a_clock_to_a_tenth_of_a_second(
    run: Run, pacing: str, cycles: int, open_at_its_end: bool
) -> None:
    cut = rows_of(run.log, cycles, "executive")
    metadata = {**run.log.metadata, "executive": {"pacing": pacing}}
    judge = Judge.of(dataclasses.replace(run._judge.rig))
    always = judge.requirements(dataclasses.replace(cut, metadata=metadata))[1]
    assert (always.held, always.open) == ((None, 1) if open_at_its_end else (True, 0)), always


def test_cycles_without_a_record_are_told(run: Run, tmp_path: Path) -> None:
    gone = rows_of(run.log, 600, "plant")
    always, settles = run._judge.requirements(gone)[1], run._judge.requirements(gone)[3]
    assert (always.unrecorded, always.held) == (100, None), "nothing is known up to the end"
    assert settles.held is None and settles.open == 1, settles
    there = run._judge.requirements(run.log)[1]
    assert there.unrecorded == 0 and there.held, there
    absent = dataclasses.replace(run.log, node={"executive": run.log.node["executive"]})
    found = run._judge.requirements(absent)
    assert [one.reason for one in found if one.held is None] == ["the log has no plant"] * 4
    assert found[0].first_cycle == 500


@pytest.mark.parametrize("pacing", ["real", "sync", "lockstep"])
def test_a_violation_on_purpose_has_its_exact_cycle_on_a_bus(
    run: Run, pacing: str, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    done = pcpc(
        "run",
        str(rig_file(tmp_path, ALL)),
        "-o",
        str(folder),
        "--bus",
        own_bus(),
        "--quiet",
        "--pacing",
        pacing,
        "--json",
        "--no-figure",
        *PATIENT,
    )
    assert done.code == 1, done
    told, recorded = done.summary["requirements"], open(folder)
    cycle = recorded.log.node["executive"].cycle
    for number in (0, 5):  # the error that is too large, the step that is too fast
        first = told[number]["first_cycle"]
        assert first == cycle[cycle >= 500][0], (first, "the step is at 500, or skipped")
    same(recorded.requirements, [JudgedRequirement(**_without_text(one)) for one in told])
    if pacing == "lockstep":
        same(recorded.requirements, run.requirements)


def _without_text(one: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in one.items() if key != "text"}


# --------------------------------------------------------------------------------- the user's side


def test_the_figure_marks_violations(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    marked: list[Any] = []
    monkeypatch.setattr(
        pages, "mark_violations", lambda axes, marks, end_s: marks and marked.append(marks)
    )
    run.figure()
    assert marked[0][0] == (0.5, "no large error") and len(marked[0]) == 4, marked


@pytest.mark.parametrize(
    ("entry", "why"),
    [
        ({"always": "controller.e_rad < 1", "after": "1.2ms", "before": "1.8ms"},
         "no cycle lies in its time"),
        ({"when": "3s", "then": "controller.e_rad < 1", "before": "2s"},
         "no cycle lies in its time"),
        ({"settles": "controller.e_rad", "into": "1 rad", "when": "0.1s", "within": "0.2s",
          "before": "0.2s"},
         "no cycle lies in its time"),
        ({"always": "controller.e_rad < 1", "after": "90s"},
         r"the run ended before its time began, at 90\.0 s"),
        ({"when": "90s", "then": "controller.e_rad < 1"},
         r"the run ended before its time began, at 90\.0 s"),
        *(({"when": when, "then": "controller.e_rad < 1", **more}, said) for when, more, said in (
            ("time.t_s > 90s", {}, r"the run ended before its time began, at 90\.001 s"),
            ("plant:time.t_s >= 90s", {}, r"the run ended before its time began, at 90\.0 s"),
            ("abs(time.t_s - 100s) <= 100ms", {}, r".* before its time began, at 99\.9 s"),
            ("not time.t_s < 90s", {"after": "1min"}, r".* before its time began, at 90\.0 s"),
            ("time.t_s > 90s", {"before": "1min"}, "no cycle lies in its time"),
            ("time.t_s > 1s", {"after": "1min"}, "its event never happened"),
            ("time.t_s < 0", {}, "its event never happened"),
            ("time.t_s > 90s and controller.e_rad < 9", {}, "its event never happened"),
            ("time.t_s > 90s or controller.e_rad > 9", {}, "its event never happened"),
        )),
        *(({"overshoot": "controller.e_rad", "over": "reference.q_d_rad", "at_most": "1 rad",
            "when": when}, said) for when, said in (
            ("90s", r"the run ended before its time began, at 90\.0 s"),
            ("0.2s", "its event never happened"),
            ("time.t_s > 200ms", "its event never happened"),
        )),
        ({"when": "controller.e_rad > 1000", "then": "controller.e_rad < 1"},
         "its event never happened"),
        ({"when": "abs(controller.e_rad) > 100 mrad", "then": "controller.e_rad > 9",
          "within": "90s"},
         "the run ended before its time was over"),
        ({"settles": "controller.e_rad", "into": "1 rad", "when": "0s", "within": "90s"},
         "the run ended before its time was over"),
    ],
)  # fmt: skip
def test_what_was_not_judged_says_the_true_reason(
    entry: dict[str, str], why: str, run: Run
) -> None:
    with pytest.raises(NotOk, match=f"not judged: {why}$"):
        run.require(**entry)


def test_a_run_can_be_asked_from_python(run: Run) -> None:
    held = run.require(always="abs(controller.e_rad) < 20 deg")
    assert held.held and held.margin_unit == "rad" and isinstance(held, JudgedRequirement)
    with pytest.raises(NotOk, match=r"^never .* violated first at cycle 500, 0\.5 s: abs\("):
        run.require(never="abs(controller.e_rad) > 100 mrad")
    with pytest.raises(AssertionError, match="not judged: its event never happened"):
        run.require(when="controller.e_rad > 1000", then="controller.e_rad < 1")
    with pytest.raises(Error, match=r"^require: always: no variable .* did you mean"):
        run.require(always="controller.e_rd < 1")
    with pytest.raises(Error, match="unknown field `alway`"):
        run.require(alway="controller.e_rad < 1")
    with pytest.raises(NotOk, match="no large error: violated first at cycle 500"):
        run.check()


def test_any_log_is_judged_by_its_rig_and_by_others(run: Run, tmp_path: Path) -> None:
    own = run_here("report", "--requirements", run.path.parent)
    lines = " ".join(own.out.split())
    assert own.code == 1 and "no large error: violated first at cycle 500, 0.5 s: abs(" in lines
    assert all(len(line) <= 80 for line in own.out.splitlines()), own.out
    held = run_here("report", run.path, "--require", "never: controller.e_rad > 1 rad", "--json")
    (told,) = json.loads(held.out)
    assert held.code == 0 and told["held"] and told["margin_unit"] == "rad", held
    wrong = run_here(
        "report", "--requirements", run.path, "--require", "never: controller.e_rd > 1"
    )
    assert wrong.code == 2 and "did you mean controller.e_rad?" in wrong.err, wrong
    none = run_here("report", "--requirements", barrel_log("pd"))
    assert none.code == 2 and "requires nothing of pd; try --require" in none.err, none


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("{always: controller.e_rd < 1}", ":6:6: require[0].always: no variable controller"),
        ('{always: "plant:barrel.theta < 1"}', "did you mean plant:barrel.theta_rad?"),
        ("{always: controller.e_rad < 1 N m}", "is in 'rad', 1 N m is in 'N m'"),
        ("{always: controller.kv_Nms_rad < 1}",
         "controller.kv_Nms_rad is a parameter, not recorded; events tell its changes"),
        ("{settles: muzzle_error_rad, into: 2 m}", ":6:33: require[0].into: abs(muzzle_error_rad)"),
        ("{alway: controller.e_rad < 1}", "require[0].alway: unknown key; did you mean always?"),
        ("{always: x < 1, never: y < 1}", ":6:21: require[0].never: always and never in one"),
        ("{then: x < 1}", "require[0].then: key when is missing"),
        ("{always: x < 1, into: 1}", ":6:21: require[0].into: does not go with always"),
        ("{always: x < 1, within: 1s}", "require[0].within: needs until"),
        ("{always: x < 1, until: x > 1, before: 1s}", "require[0].before: does not go with until"),
        ("{always: x < 1, after: 2s, before: 1s}", "1s is not later than after"),
        ("{always: x < 1, after: 9999999min}", "no more than 12 days"),
        ("{always: x < 1, after: 2 weeks}", ":6:21: require[0].after: expected text of the form"),
        ("{always: 1 < 2}", "require[0].always: names no variable"),
        ("{overshoot: x, over: y, at_most: x}", "require[0].at_most: expected a number"),
        ("{name: nothing}", "require[0]: no condition; give one of always"),
        ("{always: x < 1, controllers: [pdd]}", "no controller pdd; did you mean pd?"),
        ("{rate: controller.e_rad, at_most: 3 rad}", "in 'rad/s', 3 rad is in 'rad'"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_before_the_run_with_its_place(
    entry: str, said: str, tmp_path: Path
) -> None:
    path = rig_file(tmp_path, f"  - {entry}\n")
    with pytest.raises(RigError) as caught:
        check(Judge.of(load_rig(path)), [])
    told = str(caught.value)
    assert told.startswith(str(path)) and said in told and "\n" not in told, told


def test_what_is_judged_does_not_depend_on_what_is_kept(run: Run, tmp_path: Path) -> None:
    done = pcpc(
        "simulate",
        str(rig_file(tmp_path, ALL)),
        "-o",
        str(tmp_path / "run"),
        "--quiet",
        "--json",
        "--no-figure",
        "--set",
        "record.keep=10ms",
    )
    assert done.summary["records"]["written"] == 0, done
    assert done.summary["requirements"] == [one.json() for one in run.requirements]


def test_a_rig_without_an_evaluation_has_requirements_too(tmp_path: Path) -> None:
    path = rig_file(tmp_path, f"  - {{{PAST}}}\n", "null")
    assert check(Judge.of(load_rig(path)), []) == []
    done = pcpc("simulate", str(path), "-o", str(tmp_path / "run"), "--quiet", "--json")
    written = json.loads((tmp_path / "run" / "summary.json").read_text("utf-8"))
    assert done.code == 1 and written["requirements"][0]["first_cycle"] == 500, written
    wrong = rig_file(tmp_path, "  - {always: controller.e_rd < 1}\n")
    refused = pcpc("simulate", str(wrong), "-o", str(tmp_path / "no"), "--quiet")
    assert refused.code == 2 and "did you mean controller.e_rad" in refused.err, refused


# ----------------------------------------------------------------------------------- the id


IDS = f"""\
  - {{id: REQ-7, {PAST}}}
  - {{id: REQ-8, name: no jump, always: abs(muzzle_error_rad) < 1}}
  - {{always: time.t_s >= 0}}
"""
LIMITS = "{{pd: {{muzzle_error_rms_mrad: {{low: {}, high: 1000, id: REQ-12}}}}}}"


def with_ids(folder: Path, low: float = 0.0) -> Path:
    """Write the step of 10 deg with requirements and a limit that have ids."""
    path = rig_file(folder, IDS)
    text = path.read_text("utf-8").replace("expect: null", f"expect: {LIMITS.format(low)}")
    path.write_text(text, "utf-8")
    return path


def test_an_id_stands_wherever_its_requirement_is_named(tmp_path: Path) -> None:
    run = simulate(with_ids(tmp_path, low=900.0), folder=tmp_path / "run", quiet=True)
    told = json.loads((tmp_path / "run/summary.json").read_text("utf-8"))
    assert [one.get("id") for one in told["requirements"]] == ["REQ-7", "REQ-8", None]
    assert told["requirements"][1]["name"] == "REQ-8 no jump"
    assert told["ids"] == {"muzzle_error_rms_mrad": "REQ-12"}
    assert told["expectations_failed"][0].startswith("REQ-12 muzzle_error_rms_mrad = ")
    shown = report.rows(run.result, tmp_path, 100)
    assert any("REQ-12 muzzle_error_rms_mrad" in line for line in shown["metrics"]), shown
    assert any(line.startswith("REQ-8 no jump: met") for line in shown["require"]), shown
    page = run.report(tmp_path / "report.html").read_text("utf-8")
    for text in ("REQ-7 never abs(", "REQ-8 no jump", "REQ-12 muzzle_error_rms_mrad"):
        assert text in page, text


def test_a_rig_without_ids_has_none_in_its_files(run: Run) -> None:
    told = json.loads(run.path.with_name("summary.json").read_text("utf-8"))
    assert "ids" not in told
    assert not any("id" in one for one in told["requirements"])
    assert "{id" not in run.log.attachments["rig-resolved.yaml"]
    assert "\n  id:" not in run.log.attachments["rig-resolved.yaml"]


@pytest.mark.parametrize(
    ("requirements", "expect", "what"),
    [
        ("{id: 12, always: time.t_s >= 0}", "null", "require[0].id: expected text"),
        ("{id: '', always: time.t_s >= 0}", "null", "require[0].id: expected text of the form"),
        ("{id: a b, always: time.t_s >= 0}", "null", "of the form [A-Za-z0-9]"),
        ("{id: -7, always: time.t_s >= 0}", "null", "require[0].id: expected text"),
        (f"{{id: {'x' * 41}, always: time.t_s >= 0}}", "null", "require[0].id: expected text"),
        ('{id: "R\\u0007", always: time.t_s >= 0}', "null", "rig.yaml:"),
        ("{id: [R], always: time.t_s >= 0}", "null", "require[0].id: expected text"),
        ("{id: R}", "null", "no condition"),
        ("{id: R, always: time.t_s >= 0}\n  - {id: R, never: time.t_s < 0}", "null",
         "require[1].id: R is the id of require 0 too; give each requirement its own"),
        ("{id: R, always: time.t_s >= 0}", "{pd: {muzzle_error_rms_mrad: {high: 9, id: R}}}",
         "expect.pd.muzzle_error_rms_mrad.id: R is the id of require 0 too"),
        ("{id: R, always: time.t_s >= 0}", "{pd: {muzzle_error_rms_mrad: {id: Q}}}",
         "expect.pd.muzzle_error_rms_mrad: limits nothing"),
        ("{id: R, always: time.t_s >= 0}", "{pd: {muzzle_error_rms_mrad: {high: 9, it: Q}}}",
         "expect.pd.muzzle_error_rms_mrad.it: unknown key"),
        ("{id: R, always: time.t_s >= 0}", "{pd: {muzzle_error_rms_mrad: {high: big, id: Q}}}",
         "expect.pd.muzzle_error_rms_mrad.high: expected a number"),
        ("{id: R, always: time.t_s >= 0}", "{pd: {muzzle_error_rms_mrad: [1]}}",
         "expect.pd.muzzle_error_rms_mrad: expected a list of length 2"),
    ],
)  # fmt: skip
def test_a_wrong_id_is_refused_in_its_place(
    tmp_path: Path, requirements: str, expect: str, what: str
) -> None:
    path = rig_file(tmp_path, f"  - {requirements}\n")
    path.write_text(path.read_text("utf-8").replace("expect: null", f"expect: {expect}"), "utf-8")
    with pytest.raises(RigError) as refused:
        load_rig(path)
    assert what in str(refused.value)
    assert str(refused.value).startswith(f"{path}:"), refused.value


def test_two_controllers_may_share_an_id(tmp_path: Path) -> None:
    path = rig_file(
        tmp_path,
        "  - {id: R, always: time.t_s >= 0, controllers: [pd]}\n"
        "  - {id: R, always: time.t_s >= 1, controllers: [pid]}\n",
    )
    assert len(load_rig(path).config.require) == 2
