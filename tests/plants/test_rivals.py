"""The comparison of the barrel's laws: paired cases, ratios and intervals of results made up."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from pcpc.plants.atb1000.book import rivals
from pcpc.plants.atb1000.book.tuning import RMS, STEP
from pcpc.plants.study import Case, CaseResult

CASES = list(rivals.cases(plants=6))
MARGINS = dict.fromkeys(rivals.LAWS, 1.0)


def made_up(factors: Mapping[str, float]) -> list[CaseResult]:
    """Return results with an error of its own a plant and seed, times the factor of the law."""

    def error(case: Case) -> float:
        own = np.random.default_rng([int(case.label), len(case.group)]).uniform(1.0, 3.0)
        return float(own * factors.get(case.controller, 4.0))

    return [CaseResult(case, {RMS: error(case), STEP: 0.1}) for case in CASES]


def test_all_laws_run_on_the_same_plants_with_the_same_noise() -> None:
    for group, laws in (("nominal", rivals.LAWS), ("plants", rivals.ON_PLANTS)):
        settings = {
            law: [
                (c.rig, c.label, c.settings)
                for c in CASES
                if c.group == group and c.controller == law
            ]
            for law in laws
        }
        assert all(some == settings["pd"] and some for some in settings.values())
    assert len({c.settings for c in CASES if c.group == "plants" and "hull" not in c.rig}) == 6
    tuned = {f"seed={seed}" for seed in (11, 12)}
    assert not any(tuned & set(c.settings) for c in CASES), "noise that the tuning saw"


def test_a_constant_ratio_is_told_and_who_is_better_counted() -> None:
    results = made_up({"pd_feedforward": 1.0, "pd_nn_fast": 0.5, "lqg": 2.0})
    text = rivals.report(results, MARGINS)
    (row,) = [line for line in text.splitlines() if line.startswith("| hull | pd_nn_fast |")]
    assert "| 0.5 (" in row and "| 6 |" in row, row
    (row,) = [line for line in text.splitlines() if line.startswith("| hull | lqg |")][:1]
    assert "| 2 (" in row and "| 4 (" in row and row.count("| 0 |") == 2, row
    assert "| hull | pd_feedforward" in text and "pd_nn_fast 0.9" in text


def test_the_interval_holds_the_mean_and_narrows_with_the_plants() -> None:
    draw = np.random.default_rng(5)
    widths = []
    for count in (10, 1000):
        mean, low, high = rivals.interval(np.exp(draw.normal(0.3, 0.5, count)))
        assert low < mean < high
        widths.append(high / low)
    assert widths[1] < 1.1 < widths[0], widths
    assert low < np.exp(0.3) < high, (low, high)


def test_frictions_are_those_of_the_plants() -> None:
    found = rivals.frictions(made_up({}))
    assert len(found) == 6 and (found >= 0.5).all() and (found <= 2.0).all(), found


def test_the_figure_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    rivals.draw(made_up({}), tmp_path / "rivals.png")
    assert (tmp_path / "rivals.png").stat().st_size > 10_000
