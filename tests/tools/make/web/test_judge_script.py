"""A page judges a run as `pcpc simulate` does: metrics, limits, requirements."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from judging_node import judged_in_node, node_json, page_columns

from pcpc.executive.log.reader import Log
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig import schema
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.schema import Requirement
from pcpc.plants.evaluation import Evaluation, Judged, Mean, Peak, Rms, Run, Vector
from pcpc.tools.after.verdict.judge import Judge, Judgement
from pcpc.tools.make.web import judge_script
from pcpc.tools.make.web.judge_script import judge_data
from pcpc.tools.make.web.symbols import BINARY, UNARY, plain
from pcpc.tools.start.rigs import find

RELATIVE = 1e-9
ALL_KINDS: tuple[dict[str, str], ...] = (
    {"always": "x < 2"},
    {"always": "0.1 * x + 0.1 <= 0.3"},
    {"always": "x < 1.5 or y > 0 and not abs(y) < 0.3", "after": "10ms"},
    {"never": "-0.2 < x - 2 * y < 0.2", "before": "90ms"},
    {"always": "x < 1.9", "until": "y > 1.9"},
    {"always": "x < 1.99", "until": "y > 1.99", "within": "30ms"},
    {"always": "x != y", "until": "y > 5"},
    {"when": "x > 1", "then": "y > 1", "within": "4ms"},
    {"when": "y changes", "then": "max(x, y) >= 0", "within": "3ms", "for": "2ms"},
    {"when": "20ms", "then": "sqrt(x) > 1", "within": "10ms"},
    {"when": "5s", "then": "x > 1"},
    {"settles": "x", "into": "1.5", "when": "z changes", "within": "10ms"},
    {"settles": "x", "to": "y", "into": "0.9", "within": "5ms", "for": "1ms"},
    {"overshoot": "x", "over": "z", "at_most": "50 %"},
    {"overshoot": "x", "over": "z", "at_most": "2.5", "when": "z changes"},
    {"rate": "x", "at_most": "3900"},
    {"always": "rate(x) / rate(y) < 1e4"},
    {"always": "x < 2", "after": "1.2ms", "before": "1.8ms"},
    {"settles": "x", "into": "1.5", "when": "20ms", "within": "30ms", "before": "40ms"},
    {"when": "5s", "then": "x > 1", "before": "1s"},
    {"when": "time.t_s > 20ms", "then": "x > 1", "within": "10ms"},
    {"when": "time.t_s > 5s", "then": "x > 1"},
    {"when": "time.t_s > 5s", "then": "x > 1", "before": "1s"},
    {"when": "time.t_s < 0", "then": "x > 1"},
    {"overshoot": "x", "over": "z", "at_most": "2.5", "when": "5s"},
    {"overshoot": "x", "over": "z", "at_most": "2.5", "when": "25ms"},
)


def answer(
    folder: Path, rig: Rig, log: Log, cycles: int, changed: Sequence[str] = ()
) -> dict[str, Any]:
    """Return what the page says of the first cycles of a log."""
    period_s = 1.0 / rig.config.rate_hz
    return judged_in_node(folder, judge_data(rig, changed), page_columns(log), cycles, period_s)


def number(told: object) -> float:
    return float(str(told).replace("Infinity", "inf"))


def failed_lines(native: Judgement) -> list[str]:
    return [str(one) for one in native.findings if one.held is False]


def assert_same(native: Judgement, page: dict[str, Any]) -> None:
    """Compare metrics to 1e-9, and in words what was limited and required."""
    told = {one["name"]: one for one in page["metrics"]}
    known = {name for name, one in told.items() if one["value"] != "NaN"}
    assert known == set(native.metrics), told
    for name, value in native.metrics.items():
        assert number(told[name]["value"]) == pytest.approx(value, rel=RELATIVE), name
    assert [line.split("; did you")[0] for line in failed_lines(native)] == page["failed"]
    assert [one.text for one in native.requirements] == [
        one["words"] for one in page["requirements"]
    ]
    assert [one.held for one in native.requirements] == [one["met"] for one in page["requirements"]]
    left = bool(native.findings) and all(one.held is None for one in native.findings)
    assert page["word"] == (
        "expectation not met" if failed_lines(native) else "not judged" if left else "ok"
    )


@pytest.mark.parametrize(
    ("name", "controller"),
    [("hull", "pd"), ("step10", "pid"), ("friction-a", "pd"), ("suspension-58", None),
     ("suspension-free", "outer"), ("backlash-map", "inversion"), ("payload-on", "pd"),
     ("two-deadzones", "fuzzy"), ("fuzzy-d01", "fuzzy"), ("deadzone-step", "pd"),
     ("backlash-pendulum", "pd"), ("telerobot-u1", "pd")],
)  # fmt: skip
def test_a_page_judges_a_shipped_rig_as_natively(
    tmp_path: Path, name: str, controller: str | None
) -> None:
    rig = load_rig(find(name), controller)
    log = in_memory(rig)
    assert_same(
        Judge.of(rig).judge(log, []), answer(tmp_path, rig, log, len(log.node["executive"].cycle))
    )


@pytest.mark.parametrize(
    ("name", "settings"),
    [("step10", ["duration_s=0.2"]), ("probe", ["duration_s=0.1"]),
     ("step10", ["duration_s=0.2", "require=[{always: controller.e_rad < 9, after: 7s}]"]),
     ("probe", ["duration_s=0.1", "require=[{when: 7s, then: controller.command < 9}]"]),
     ("step10", ["duration_s=0.2", "require=[{always: controller.e_rad < 9}]"]),
     ("step10", ["duration_s=0.2", "require=[{always: controller.e_rad < 0}]"])],
)  # fmt: skip
def test_a_run_that_nothing_judges_is_not_judged_in_a_page_either(
    tmp_path: Path, name: str, settings: list[str]
) -> None:
    rig = load_rig(find(name), settings=settings)
    log = in_memory(rig)
    page = answer(tmp_path, rig, log, len(log.node["executive"].cycle), settings)
    assert_same(Judge.of(rig).judge(log, settings), page)


def required(
    monkeypatch: pytest.MonkeyPatch, columns: dict[str, Vector], evaluation: Evaluation | None
) -> tuple[Rig, Log]:
    """Return the probe with all kinds of requirements, and a log of other columns."""
    rig = load_rig(find("probe"), settings=["duration_s=0.1"])
    rig = rig.changed(require=[msgspec.convert(one, Requirement) for one in ALL_KINDS])
    made = judge_script.imagined_log

    def imagined(*given: Any) -> Log:
        log = made(*given)
        log.node["executive"] = replace(log.node["executive"], columns=columns)
        return log

    monkeypatch.setattr(judge_script, "imagined_log", imagined)
    if evaluation is not None:
        monkeypatch.setattr(Judge, "of", lambda rig: Judge(rig, evaluation))
    return rig, imagined(rig, "virtual")


@pytest.mark.parametrize("seed", range(30))
def test_requirements_of_every_kind_are_judged_as_natively(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-2.0, 2.0, (2, 100)) if seed % 3 else rng.integers(-2, 3, (2, 100)) * 1.0
    z = np.repeat(rng.integers(-2, 3, 5) * 1.0, 20)
    if seed % 5 == 0:
        x[rng.integers(0, 100, 3)], y[rng.integers(0, 100, 3)] = math.nan, math.inf
    time_s = 1e-3 * np.arange(100)
    rig, log = required(monkeypatch, {"x": x, "y": y, "z": z, "time.t_s": time_s}, None)
    assert_same(Judge.of(rig).judge(log, []), answer(tmp_path, rig, log, 100))
    end = int(rng.integers(1, 100)) if seed else 40  # where the time of a requirement ends
    begun = Judge.of(rig).judge(_first_cycles(log, end), [], "the run did not finish")
    page = answer(tmp_path, rig, log, end)["requirements"]
    assert [one.text for one in begun.requirements] == [one["words"] for one in page]


def _first_cycles(log: Log, end: int) -> Log:
    nodes = {
        name: replace(
            node,
            cycle=node.cycle[:end],
            stamp_ns=node.stamp_ns[:end],
            timing={},
            columns={key: values[:end] for key, values in dict(node.columns).items()},
        )
        for name, node in log.node.items()
    }
    return replace(log, node=nodes)


def test_a_run_that_was_cut_off_leaves_limits_and_obligations_open(tmp_path: Path) -> None:
    rig = load_rig(find("step10"), "pid")
    log = in_memory(rig)
    page = answer(tmp_path, rig, log, 1000)
    assert page["word"] == "the run did not finish"
    assert {one["met"] for one in page["metrics"] if "limit" in one} == {None}


@pytest.mark.parametrize(("at", "end_s", "failed"), [
    (0, 0.1, ["mean", "peak"]), (40, 0.1, ["mean", "peak"]), (99, 0.1, ["mean", "peak"]),
    (59, 0.06, ["mean", "peak"]), (60, 0.06, ["mean"]),
])  # fmt: skip
def test_a_value_that_is_none_fails_what_ignores_it_in_the_order_of_the_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int, end_s: float, failed: list[str]
) -> None:
    x = np.ones(100)
    x[at] = math.nan
    merits = {"peak": Peak(lambda run: run["x"]), "mean": Mean(lambda run: run["y"])}
    evaluation = Evaluation(merits=merits)
    rig, log = required(monkeypatch, {"x": x, "y": np.ones(100), "z": np.ones(100)}, evaluation)
    limits = {"mean": [2.0, 3.0], "peak": [0.0, 2.0]}
    rig = rig.changed(expect={rig.config.controller: limits}, require=[])
    window = schema.Evaluation(file="", window_s=(0.0, end_s))
    monkeypatch.setattr(Judge, "given", window)
    native = Judge.of(rig).judge(log, [])
    page = answer(tmp_path, rig, log, 100)
    assert failed_lines(native) == page["failed"]
    assert [line.split()[0] for line in page["failed"]] == failed


def test_what_cannot_be_written_down_is_named_and_the_rest_is_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sorted_mean(judged: Judged) -> float:
        return float(np.sort(judged.run()["x"])[3])

    def branching(judged: Judged) -> float:
        found = judged.measured({"a": Mean("x"), "b": Peak("y")})
        return found["a"] if found["a"] > found["b"] else 2.0 * found["b"]

    def summed(run: Run) -> Vector:
        return np.cumsum(run["x"])

    evaluation = Evaluation(
        merits={
            "read": lambda judged: float(len(judged.log.node["executive"].frames)),
            "sorted": sorted_mean, "sum": Rms(summed), "branch": branching,
            "turned": Mean(lambda run: np.where((run["x"] > 0) & ~(run["y"] > 1), run["x"], 0.5)),
            "apart": Mean(lambda run: run["x"] if (run["x"] > 0).any() else run["y"]),
        }
    )  # fmt: skip
    rng = np.random.default_rng(0)
    columns = dict(zip("xyz", rng.uniform(-2.0, 2.0, (3, 100)), strict=True))
    rig, log = required(monkeypatch, columns, evaluation)
    page = answer(tmp_path, rig, log, 100)
    told = {one["name"]: one for one in page["metrics"]}
    for name in ("read", "sorted", "sum", "apart"):
        assert told[name]["why"].startswith("not judged in a page: it "), told[name]
    native = evaluation.figures(evaluation.judged(log, (-math.inf, math.inf), {}, 1e-3))
    for name in ("branch", "turned"):
        assert told[name]["value"] == pytest.approx(native[name], rel=RELATIVE)


def test_operations_and_numbers_as_words_are_those_of_numpy_and_python(tmp_path: Path) -> None:
    ends = (0.0, 0.5, -0.5, 1.5, 2.5, -1.0, 1.0, 0.1, 3.7, -7.25, math.inf, -math.inf, math.nan)
    words = (*ends, 1234.5, 1235.5, 0.00001, 123456.0, 99995.0, 1e22, 1e-7, 1 / 3, 1e16, 4e-324)
    script = f"""
import {{ NUMBER_OPERATIONS as act }} from "./vectors.mjs";
import {{ shortNumber, pythonNumber }} from "./judge.mjs";
const ends = {json.dumps([plain(one) for one in ends])}.map(Number);
const words = {json.dumps([plain(one) for one in words])}.map(Number);
const told = {{}};
for (const one of {json.dumps(UNARY)}) told[one] = ends.map((a) => String(act[one](a)));
for (const one of {json.dumps(BINARY)}) {{
  told[one] = ends.flatMap((a) => ends.map((b) => String(act[one](a, b))));
}}
const short = [1, 4, 6, 12].map((n) => words.map((one) => shortNumber(one, n)));
const whole = words.filter(Number.isFinite).map(pythonNumber);
console.log(JSON.stringify({{ told, short, whole, known: Object.keys(act) }}));
"""
    found = node_json(tmp_path, script)
    assert {*found["known"]} == {*UNARY, *BINARY, "where"}
    with np.errstate(all="ignore"):
        a, b = np.repeat(ends, len(ends)), np.tile(ends, len(ends))
        for one in UNARY:
            told = [number(value) for value in found["told"][one]]
            np.testing.assert_allclose(
                told, getattr(np, one)(np.array(ends)), 1e-14, 0, err_msg=one
            )
        for one in BINARY:
            told = [number(value) for value in found["told"][one]]
            np.testing.assert_allclose(told, getattr(np, one)(a, b), 1e-14, 0, err_msg=one)
    assert found["short"] == [[f"{one:.{n}g}" for one in words] for n in (1, 4, 6, 12)]
    assert found["whole"] == [repr(one) for one in words if math.isfinite(one)]
