"""Evaluation files: what is wrong with one is told before a run, and costs no summary after it."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from processes import RIGS, pcpc

from pcpc.executive.errors import RigError
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.judge import Judge, check
from pcpc.tools.summary import CODES, Outcome, note_figure, summarise

BODY = """\
from pcpc.plants.judging import Run, rms


def metrics(log, window_s, numbers, period_s):
    run = Run(log, period_s)
    return {"error_rms": rms(run.executive("controller.e_rad"))}


def figure(log, path, title, metrics, window_s):
    path.write_bytes(b"")
"""
Write = Callable[..., Rig]


@pytest.fixture
def rig(tmp_path: Path) -> Write:
    """Return a function that writes a rig with an evaluation of its own."""

    def write(body: str = BODY, metric: str = "error_rms") -> Rig:
        (tmp_path / "own.py").write_text(body)
        (tmp_path / "rig.yaml").write_text(
            f"base: {RIGS / 'slew10.yaml'}\nrig: own\nduration_s: 0.2\n"
            "controllers: {own: {law: pd, parameters: {kv_Nms_rad: 110.0, lam_per_s: 16.0,"
            " km_Nms_rad: 60.0, gear_ratio: 60.0, tau_max_Nm: 115.0}}}\n"
            "evaluation: {file: own.py, window_s: [0.0, 0.2]}\n"
            f"expect: {{own: {{{metric}: [0.0, 1.0]}}}}\n"
        )
        return load_rig(tmp_path / "rig.yaml", "own")

    return write


def refusal(rig: Rig) -> str:
    """Return why `pcpc check` refuses a rig."""
    with pytest.raises(RigError) as error:
        check(Judge.of(rig), [])
    assert "\n" not in str(error.value), str(error.value)
    return str(error.value)


def test_a_sound_evaluation_passes(rig: Write) -> None:
    assert check(Judge.of(rig()), []) == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("return {", "return {{", "own.py:6: "),
        ("Run, rms", "Run, rsm", "own.py:1: cannot import name 'rsm'"),
        ("def metrics", "def metric", "own.py: no function metrics; expected metrics(log, window"),
        ("numbers, period_s)", "numbers)", "own.py: metrics: too many positional arguments"),
        ("e_rad", "e_rda", "own.py:6: executive: no variable controller.e_rda; did you mean"),
        ("rms(run", "rms(runn", "own.py:6: NameError: name 'runn' is not defined"),
        (
            'run.executive("controller.e_rad")',
            'log.node["executive"].columns["controller.e_rda"]',
            "own.py:6: no variable 'controller.e_rda'; did you mean controller.e_rad",
        ),
        ("return {", "return 3 if True else {", "own.py:"),
        ("return {", "raise SystemExit(3)\n    return {", "own.py:6: SystemExit: 3"),
        ("path.write_bytes", "path.wriet_bytes", "own.py:10: AttributeError"),
    ],
)  # fmt: skip
def test_what_would_fail_at_the_end_is_refused_with_its_line(
    old: str, new: str, said: str, rig: Write
) -> None:
    assert said in refusal(rig(BODY.replace(old, new))), refusal(rig(BODY.replace(old, new)))


def test_a_limit_of_a_metric_that_is_not_told_is_refused_with_its_place(rig: Write) -> None:
    said = refusal(rig(metric="eror_rms"))
    assert "rig.yaml:" in said and "expect.own.eror_rms" in said, said
    assert "did you mean error_rms?" in said, said


def test_a_variable_that_only_another_controller_has_is_lawful() -> None:
    for name in ("pd", "pd_nn"):
        assert check(Judge.of(load_rig(RIGS / "hull.yaml", name)), []) == []


@pytest.mark.parametrize(
    ("old", "new"), [("rms(run", "rms(runn"), ("return {", "raise SystemExit(3)\n    return {")]
)
def test_an_evaluation_that_fails_at_the_end_costs_its_metrics_only(
    old: str, new: str, rig: Write
) -> None:
    own = rig(BODY.replace(old, new))
    summary = summarise(own, in_memory(own), Outcome("virtual", "memory"))
    assert summary["verdict"] == "expectation not met" and CODES[summary["verdict"]] == 1
    assert "own.py:6: " in summary["expectations_failed"][0], summary
    assert summary["not_judged"] == {"error_rms": "the evaluation failed"}, summary
    assert summary["cycles"] == 200 and json.dumps(summary), summary


def test_a_metric_that_is_not_there_is_named_with_a_proposal(rig: Write) -> None:
    own = rig(metric="eror_rms")
    summary = summarise(own, in_memory(own), Outcome("virtual", "memory"))
    (line,) = summary["expectations_failed"]
    assert line.startswith("eror_rms is not told by this run") and "error_rms?" in line, line


def test_a_figure_that_fails_is_told_and_not_ok(rig: Write) -> None:
    own = rig()
    summary = summarise(own, in_memory(own), Outcome("virtual", "memory"))
    assert summary["verdict"] == "ok", summary
    note_figure(summary, "no figure: own.py:10: boom")
    assert summary["verdict"] == "expectation not met", summary


def test_the_run_ends_with_a_line_and_the_summary(rig: Write, tmp_path: Path) -> None:
    own = rig(BODY.replace("path.write_bytes", "path.wriet_bytes"))
    done = pcpc("simulate", str(own.path), "--controller", "own", "-o", str(tmp_path / "run"))
    assert done.code == 1 and "Traceback" not in done.err, done
    assert "own.py:10: AttributeError" in " ".join(done.out.split()), done
    assert (tmp_path / "run" / "summary.json").exists()
    refused = rig(BODY.replace("return {", "return {{"))
    done = pcpc("simulate", str(refused.path), "--controller", "own", "-o", str(tmp_path / "other"))
    assert done.code == 2 and "own.py:6" in done.err and done.err.count("\n") == 1, done
    assert not (tmp_path / "other").exists()
