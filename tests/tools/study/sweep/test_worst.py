"""The worst case: known maxima, inside, on the edge, among choices; several seeds."""

import math

import numpy as np
import pytest

from pcpc.tools.study.sweep import vary
from pcpc.tools.study.sweep.worst import APART, HIGH, LOW, Margins, worst

SEEDS = range(5)


def uniform(d: int) -> tuple[vary.Variation, ...]:
    return vary.parse_variations([f"x{i}=0:1" for i in range(d)])


@pytest.mark.parametrize("d", [1, 2, 5])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_valley_inside(d: int, seed: int) -> None:
    target = np.linspace(0.2, 0.7, d)
    points, margins = worst(lambda u: ((u - target) ** 2).sum(axis=1) - 1, uniform(d), 600, seed)
    assert margins[0] == pytest.approx(-1.0, abs=1e-3)
    assert points[0] == pytest.approx(target, abs=0.03)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_worst_case_in_a_corner_of_the_box(seed: int) -> None:
    points, margins = worst(lambda u: u[:, 0] - 2 * u[:, 1] + u[:, 2], uniform(3), 600, seed)
    assert points[0] == pytest.approx([LOW, HIGH, LOW], abs=2e-3)
    assert margins[0] == pytest.approx(2 * LOW - 2 * HIGH, abs=5e-3)


def rastrigin(u: np.ndarray) -> np.ndarray:
    """Return a margin with 100 valleys; the deepest at 0.5, 0.5 by 1 below its neighbours."""
    x = 10.0 * (u - 0.5)
    return (x**2 - 10.0 * np.cos(2.0 * math.pi * x) + 10.0).sum(axis=1)


def test_many_valleys() -> None:
    off = np.array([0.23, -0.11])
    found = [worst(lambda u: rastrigin(u + off), uniform(2), 3000, s)[1][0] for s in SEEDS]
    assert sum(margin < 0.1 for margin in found) >= 4, found
    assert max(found) < 2.1, found


@pytest.mark.parametrize("seed", SEEDS)
def test_the_level_of_a_choice(seed: int) -> None:
    mixed = vary.parse_variations(["kind=choice(3,1,2,9)", "x=0:1", "n=0:1:5"])

    def margins(u: np.ndarray) -> np.ndarray:
        value = vary.values(mixed, u, (0.0, 0.0, 0.0))
        depth = np.where(value[:, 0] == 2.0, 5.0, np.where(value[:, 0] == 3.0, 4.0, 0.0))
        return (value[:, 1] - 0.3) ** 2 + (value[:, 2] - 0.75) ** 2 - depth

    points, found = worst(margins, mixed, 800, seed)
    value = vary.values(mixed, points[:1], (0.0, 0.0, 0.0))[0]
    assert value == pytest.approx([2.0, 0.3, 0.75], abs=0.03) and found[0] < -4.99
    assert np.array_equal(vary.snap_to_levels(mixed, points), points)


def counted(margins: Margins, asked: list[np.ndarray]) -> Margins:
    def counting(u: np.ndarray) -> np.ndarray:
        asked.append(u.copy())
        return margins(u)

    return counting


@pytest.mark.parametrize("runs", [1, 15, 16, 17, 500])
def test_the_budget_is_kept_and_used_in_batches_within_the_box(runs: int) -> None:
    asked: list[np.ndarray] = []
    worst(counted(rastrigin, asked), uniform(2), runs, 1)
    every = np.concatenate(asked)
    assert len(every) == runs and every.min() >= LOW and every.max() <= HIGH
    assert all(len(batch) >= 16 for batch in asked[:-1])


def test_the_points_are_distinct_and_the_worst_that_were_asked_for() -> None:
    asked: list[np.ndarray] = []
    points, margins = worst(counted(rastrigin, asked), uniform(2), 1000, 2, most=8)
    assert margins[0] == rastrigin(np.concatenate(asked)).min()
    assert len(points) == 8 and sorted(margins) == margins.tolist()
    gaps = np.abs(points[:, None] - points[None]).max(axis=2)[~np.eye(8, dtype=bool)]
    assert gaps.min() > APART


def test_the_same_seed_asks_for_the_same_points() -> None:
    def asked(seed: int) -> bytes:
        found: list[np.ndarray] = []
        worst(counted(rastrigin, found), uniform(2), 300, seed)
        return np.concatenate(found).tobytes()

    np.random.seed(1)
    once = asked(3)
    after = np.random.random()
    np.random.seed(2)
    assert asked(3) == once != asked(4), "the points depend on numpy's own generator"
    np.random.seed(1)
    assert np.random.random() == after, "the search moved numpy's own generator"


@pytest.mark.parametrize("failed", [math.nan, -math.inf])
@pytest.mark.filterwarnings("error")
def test_a_run_that_failed_without_a_margin_is_the_worst(failed: float) -> None:
    def margins(u: np.ndarray) -> np.ndarray:
        return np.where(u.sum(axis=1) > 1.8, failed, 2.0 - u.sum(axis=1))

    points, found = worst(margins, uniform(2), 400, 5)
    assert found[0] == -math.inf and points[0].sum() > 1.8


def test_nothing_to_search_is_refused() -> None:
    with pytest.raises(ValueError, match="nothing to search"):
        worst(rastrigin, uniform(2), 0)
    with pytest.raises(ValueError, match="nothing to search"):
        worst(rastrigin, (), 10)
    with pytest.raises(ValueError, match="expected 16 margins"):
        worst(lambda u: u, uniform(2), 50)
