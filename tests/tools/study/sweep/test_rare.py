"""Rare failures: closed forms of a linear margin and of a parabola, several seeds."""

import math

import numpy as np
import pytest
from scipy.special import ndtr

from pcpc.tools.study.sweep.rare import Margins, subset

SEEDS = 40


def linear(beta: float, d: int) -> Margins:
    """Return margins that are below 0 with probability Phi(-beta), in every dimension."""
    return lambda z: beta - z.sum(axis=1) / math.sqrt(d)


@pytest.mark.parametrize("d", [1, 2, 20])
@pytest.mark.parametrize("beta", [3.0, 4.0, 5.0])
def test_a_linear_margin(beta: float, d: int) -> None:
    exact = float(ndtr(-beta))
    found = [subset(linear(beta, d), d, 1000, seed) for seed in range(SEEDS)]
    p = np.array([one.p for one in found])
    error = p.std() / math.sqrt(SEEDS)
    assert abs(p.mean() - exact) < 4.0 * error + 0.02 * exact, (p.mean() / exact, error / exact)
    covered = [low <= exact <= high for low, high in (one.interval() for one in found)]
    assert np.mean(covered) >= 0.95 - 2.0 * math.sqrt(0.05 * 0.95 / SEEDS), np.mean(covered)
    spread, told = p.std() / p.mean(), np.mean([one.cov for one in found])
    assert 0.5 < told / spread < 3.0, (told, spread)
    assert found[0].runs <= 1000 + 900 * math.ceil(-math.log10(exact))


def test_a_curved_margin_with_two_regions_of_failure() -> None:
    """|z1| > 4: 2 Phi(-4)."""
    p = np.mean([subset(lambda z: 4.0 - abs(z[:, 0]), 2, 1000, s).p for s in range(SEEDS)])
    assert p == pytest.approx(2.0 * float(ndtr(-4.0)), rel=0.15)


def test_a_margin_in_steps() -> None:
    """Equal margins reach across every bound: chains start only from what is below."""
    found = [subset(lambda z: np.floor(4.0 - z[:, 0]), 2, 1000, s) for s in range(SEEDS)]
    assert np.mean([one.p for one in found]) == pytest.approx(float(ndtr(-4.0)), rel=0.3)
    assert found[0].failing[:, 0].min() > 4.0


def test_a_likely_failure_is_counted_plainly() -> None:
    found = subset(linear(0.0, 2), 2, 1000, 1)
    assert found.runs == 1000 and found.levels == (0.0,)
    assert found.p == len(found.failing) / 1000 == pytest.approx(0.5, abs=0.06)
    assert found.cov == pytest.approx(math.sqrt((1 - found.p) / (found.p * 1000)))


@pytest.mark.parametrize("beta", [-2.0, -1.0, 0.0])
def test_few_likely_failures_are_covered_too(beta: float) -> None:
    found = [subset(linear(beta, 2), 2, 20, seed).interval() for seed in range(400)]
    covered = np.mean([low <= float(ndtr(-beta)) <= high for low, high in found])
    assert covered >= 0.95 - 2.0 * math.sqrt(0.05 * 0.95 / 400), covered


def test_failures_of_all_runs_are_no_certainty() -> None:
    low, high = subset(linear(-99.0, 2), 2, 50).interval()
    assert low == pytest.approx(0.025 ** (1 / 50)) and high == 1.0


def test_failing_points_fail_and_levels_fall_to_zero() -> None:
    margins = linear(4.5, 5)
    found = subset(margins, 5, 500, 3)
    assert len(found.failing) >= 50 and margins(found.failing).max() < 0.0
    assert sorted(found.levels, reverse=True) == list(found.levels) and found.levels[-1] == 0.0


def test_the_same_seed_asks_for_the_same_points_in_large_batches() -> None:
    def asked(seed: int) -> list[bytes]:
        batches: list[np.ndarray] = []

        def margins(z: np.ndarray) -> np.ndarray:
            batches.append(z.copy())
            return linear(4.0, 3)(z)

        subset(margins, 3, 500, seed)
        assert {len(batch) for batch in batches[1:]} == {50} and len(batches[0]) == 500
        return [batch.tobytes() for batch in batches]

    assert asked(7) == asked(7) != asked(8)


def test_margins_that_end_in_a_step_are_no_endless_search() -> None:
    """A margin of 1 everywhere, and one that falls but has no failure."""
    flat = subset(lambda z: np.ones(len(z)), 2, 100)
    assert flat.p == 0.0 and flat.runs == 100 and len(flat.failing) == 0
    never = subset(lambda z: np.exp(-z[:, 0]), 2, 200)
    assert never.p == 0.0 and never.interval() == (0.0, never.resolved)
    assert 0.0 < never.resolved < 1e-11 and flat.resolved == 0.03


def test_runs_that_failed_without_a_margin_count_as_failures() -> None:
    found = subset(lambda z: np.where(z[:, 0] > 3.5, -math.inf, 3.5 - z[:, 0]), 1, 1000, 2)
    low, high = found.interval()
    assert low < float(ndtr(-3.5)) < high and high < 10.0 * low


def test_what_is_no_margin_is_refused() -> None:
    with pytest.raises(ValueError, match="without NaN"):
        subset(lambda z: np.full(len(z), math.nan), 1, 100)
    with pytest.raises(ValueError, match="expected 100 margins"):
        subset(lambda z: z, 1, 100)
    with pytest.raises(ValueError, match="expected n p0 >= 2"):
        subset(linear(1.0, 1), 1, 15)
