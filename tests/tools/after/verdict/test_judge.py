"""Evaluation files: what is wrong with one is told before a run, and costs no summary after it."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest
from processes import RIGS, pcpc

from pcpc import open as open_run
from pcpc import simulate
from pcpc.executive.errors import RigError
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.after.verdict import summary_file
from pcpc.tools.after.verdict.findings import FindingKind, lines
from pcpc.tools.after.verdict.judge import Judge, beyond, check
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.after.verdict.summary import CODES, summarise

BODY = """\
from pcpc.plants.evaluation import RUN, Evaluation, Line, Panel, Rms, started


def error(run):
    return run["executive:controller.e_rad"]


EVALUATION = Evaluation(
    signals={"error_rad": error},
    merits={"error_rms": Rms("error_rad", RUN)},
    panels=(
        Panel("error [rad]", (Line("error_rad", "hub"),)),
        Panel("angle [rad]", (Line("plant:barrel.theta_rad", "hub"),)),
    ),
    notes=(("rms {error_rms:.4f} rad",), ()),
)
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


@pytest.mark.parametrize("node", ["executive:", "plant:", "none:"])
def test_a_sound_evaluation_passes_with_names_of_either_spelling(node: str, rig: Write) -> None:
    told = check(Judge.of(rig(BODY.replace(f'"{node}', '"'))), [])
    assert all("asks for it" in line for line in told), told  # windows of the base


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("return run", "return = run", "own.py:5: SyntaxError"),
        ("Rms, started", "Rsm, started", "own.py:1: ImportError: cannot import name 'Rsm'"),
        ("EVALUATION = E", "EVALUATE = E", "own.py: no EVALUATION; expected EVALUATION ="),
        ("EVALUATION = Evaluation(", "EVALUATION = dict(", "own.py: EVALUATION is a dict; exp"),
        ("merits=", "merit=", "own.py:8: TypeError: Evaluation.__init__() got an une"),
        ("controller.e_rad", "controller.e_rda",
         "own.py:5: executive: no variable controller.e_rda; did you mean controller.e_rad?, in"),
        ('run["executive:controller.e_rad', 'run["controller.e_rda',
         "own.py:5: no signal controller.e_rda; did you mean controller.e_rad?"),
        ('run["executive:controller.e_rad', 'run["controller.encoder_rad',
         "own.py:5: controller.encoder_rad: an input, not recorded; use its source rx.FB_A.enc"),
        ('Line("error_rad"', 'Line("controller.encoder_rad"',
         "own.py:12: controller.encoder_rad: an input, not recorded; use its source rx.FB_A.enc"),
        ('"plant:barrel.theta', '"barrel.thetta',
         "own.py:13: no signal barrel.thetta_rad; did you mean plant:barrel.theta_rad?"),
        ("return run", "return rnu", "own.py:5: NameError: name 'rnu' is not defined"),
        ("return run", "return 3.0 if True else run", "own.py:10: expected a value a cycle, 200"),
        ("return run", "return 'x' if True else run", "own.py:10: expected numbers, got str"),
        ("return run", "raise SystemExit(3)\n    return run", "own.py:5: ends the process; it"),
        ('Rms("error', 'Rms("eror', "own.py:10: no signal eror_rad; did you mean error_rad?"),
        ('Line("error', 'Line("eror', "own.py:12: no signal eror_rad; did you mean error_rad?"),
        ("barrel.theta", "barrel.thetta",
         "own.py:13: plant: no variable barrel.thetta_rad; did you mean barrel.theta_rad?"),
        ('Rms("error_rad"', 'Rms("executive:controller.e_rda"',
         "own.py:10: executive: no variable controller.e_rda; did you mean controller.e_rad?"),
        ('Rms("error_rad", RUN)', '"error_rad"', "own.py:8: merit error_rms is neither Rms(...)"),
        ("{error_rms:", "{eror_rms:", "own.py:8: notes: no merit eror_rms; did you mean"),
        ("{error_rms:.4f}", "{error_rms:.4q}", "own.py:8: notes: "),
        ("{error_rms:.4f}", "{error_rms:.4f", "own.py:8: notes: "),
        ('"error [rad]"', '"$\\\\frac{$"', "ParseSyntaxException"),
        ('notes=(("rms {error_rms:.4f} rad",), ())', 'notes=(("rms",),)',
         "own.py:8: notes: expected two rows, ("),
        ('notes=(("rms {error_rms:.4f} rad",), ())', 'notes=("rms", "max")',
         "own.py:8: notes: expected two rows, ("),
        ('(Line("error_rad", "hub"),)', '(Line("error_rad", "hub"))',
         "own.py:12: panel 'error [rad]': lines: a comma is missing behind the only Line: (Line("),
        ('(Line("error_rad", "hub"),)', '("error_rad",)',
         "own.py:12: panel 'error [rad]': lines: expected (Line(...), ...), got ('error_rad',)"),
        ("panels=(", 'panels=Panel("one", ()) or (', "own.py:8: panels: a comma is missing"),
        ("RUN)", '"ret")', "rig.yaml:6:16: expect.own.error_rms: the evaluation has"),
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
    ("old", "new"),
    [("return run", "return rnu"), ("return run", "raise SystemExit\n    return run")],
)
def test_an_evaluation_that_fails_at_the_end_costs_its_metrics_only(
    old: str, new: str, rig: Write
) -> None:
    own = rig(BODY.replace(old, new))
    summary = summarise(own, in_memory(own), Outcome("virtual", "memory"))
    assert summary.verdict == "expectation not met" and CODES[summary.verdict] == 1
    assert "own.py:5: " in summary.expectations_failed[0], summary
    assert summary.not_judged == {"error_rms": "the evaluation failed"}, summary
    assert summary.cycles == 200 and json.dumps(summary_file.plain(summary)), summary


def test_a_metric_that_is_not_there_is_named_with_a_proposal(rig: Write) -> None:
    own = rig(metric="eror_rms")
    summary = summarise(own, in_memory(own), Outcome("virtual", "memory"))
    (line,) = summary.expectations_failed
    assert line.startswith("eror_rms is not known in this run") and "error_rms?" in line, line


def test_a_window_that_is_the_whole_run_is_another_one_only_where_the_run_is() -> None:
    rig = load_rig(RIGS / "slew10.yaml")
    assert rig.evaluation is not None
    rig = rig.changed(evaluation={"file": str(rig.evaluation.file)})
    assert beyond(rig, []) == beyond(rig, ["seed=2"]) == ""
    assert beyond(rig, ["duration_s=9"]).startswith("duration_s was changed, and the window is")


def test_a_figure_that_fails_is_told_and_not_ok(rig: Write) -> None:
    own = rig()
    summary = summarise(own, in_memory(own), Outcome("virtual", "memory"))
    assert summary.verdict == "ok", summary
    summary.enter(*lines(FindingKind.EVALUATION, ["no figure: own.py:12: boom"]))
    assert summary.verdict == "expectation not met", summary


def test_a_metric_that_is_not_finite_is_read_back_and_drawn(rig: Write, tmp_path: Path) -> None:
    own = rig(
        BODY.replace(
            "merits={",
            "merits={'never_s': lambda run: float('inf'), 'low': lambda run: -float('inf'),",
        ).replace('rad",), ())', 'rad", "after {never_s:.3f} s, {low:.1f}"), ())')
    )
    made = simulate(own.path, "own", folder=tmp_path / "run", quiet=True)
    read = open_run(tmp_path / "run")
    assert made.metrics["never_s"] == math.inf and read.metrics == made.metrics, read.metrics
    assert read.metrics["low"] == -math.inf and read.figure().png.startswith(b"\x89PNG")
    assert '"never_s": "inf"' in (tmp_path / "run" / "summary.json").read_text()


def test_the_run_ends_with_a_line_and_the_summary(rig: Write, tmp_path: Path) -> None:
    own = rig(BODY.replace("return run", "return rnu"))
    done = pcpc("simulate", str(own.path), "--controller", "own", "-o", str(tmp_path / "run"))
    assert done.code == 1 and "Traceback" not in done.err, done
    assert "own.py:5: NameError" in " ".join(done.out.split()), done
    assert (tmp_path / "run" / "summary.json").exists()
    refused = rig(BODY.replace("return run", "return = run"))
    done = pcpc("simulate", str(refused.path), "--controller", "own", "-o", str(tmp_path / "other"))
    assert done.code == 2 and "own.py:5" in done.err and done.err.count("\n") == 1, done
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("name", ["resst_from_s", "rest_to_s", "gear_ration"])
def test_a_number_that_nothing_asks_for_is_told_with_its_place(name: str, tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(f"base: {RIGS / 'hull.yaml'}\nrig: own\nevaluation: {{{name}: 1.0}}\n")
    (told,) = check(Judge.of(load_rig(path)), [])
    assert f"rig.yaml:3:14: evaluation.{name}: nothing in" in told, told
    with pytest.raises(RigError, match=f"--set evaluation.{name}"):
        Judge.of(load_rig(RIGS / "hull.yaml", settings=[f"evaluation.{name}=1.0"]))


@pytest.mark.parametrize("limits", ["[10.0, 20.0]", "[-2.0, -1.0]"])
def test_a_metric_outside_either_limit_is_no_pass(limits: str, rig: Write) -> None:
    path = rig().path
    path.write_text(path.read_text().replace("[0.0, 1.0]", limits))
    own = load_rig(path, "own")
    summary = summarise(own, in_memory(own), Outcome("virtual", "memory"))
    assert summary.verdict == "expectation not met", summary
    assert summary.expectations_failed[0].startswith("error_rms = "), summary
