"""Sensitivity: closed forms of a linear model, the Ishigami function and an interaction."""

import math

import numpy as np
import pytest

from pcpc.tools.study.sweep import vary
from pcpc.tools.study.sweep.sensitivity import Share, shares

CUBE = vary.parse_variations([f"x{i}=-3.141592653589793:3.141592653589793" for i in (1, 2, 3)])


def ishigami(x: np.ndarray) -> np.ndarray:
    """S1 = 0.3139, 0.4424, 0; ST = 0.5576, 0.4424, 0.2437 for a = 7, b = 0.1."""
    return np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def drawn(n: int, sampling: str, seed: int = 1) -> np.ndarray:
    return vary.values(CUBE, vary.points(CUBE, n, sampling, seed), (0.0, 0.0, 0.0))


def by_name(found: list[Share]) -> dict[str, Share]:
    return {share.name: share for share in found}


@pytest.mark.parametrize("sampling", ["random", "lhs", "sobol"])
def test_the_ishigami_function(sampling: str) -> None:
    x = drawn(4096, sampling)
    found = shares(("x1", "x2", "x3"), x, ishigami(x))
    assert [share.name for share in found] == ["x2", "x1", "x3"]
    for share, exact in zip(found, (0.4424, 0.3139, 0.0), strict=True):
        assert share.first == pytest.approx(exact, abs=0.03), share
        assert share.low - 0.01 < exact < share.high + 0.01 and share.high - share.low < 0.1
        assert math.isnan(share.total)


def test_a_linear_model_with_noise_and_a_variation_that_does_nothing() -> None:
    rng = np.random.default_rng(2)
    x = rng.random((3000, 3))
    y = 3.0 * x[:, 0] + 4.0 * x[:, 1] + math.sqrt(25 / 12) * rng.standard_normal(3000)
    found = by_name(shares("abc", x, y))
    for name, exact in (("a", 0.18), ("b", 0.32), ("c", 0.0)):  # 9, 16 and 0 of 50
        assert found[name].first == pytest.approx(exact, abs=0.03), found[name]


@pytest.mark.parametrize(("n", "runs"), [(60, 400), (500, 100)])
def test_the_estimate_has_no_bias_from_noise(n: int, runs: int) -> None:
    rng = np.random.default_rng(3)
    found = [
        shares("a", rng.random((n, 1)), rng.standard_normal(n))[0].first for _ in range(runs // 10)
    ]
    error = np.std(found) / math.sqrt(len(found))
    assert abs(np.mean(found)) < 4.0 * error, (np.mean(found), error)


def test_intervals_cover_at_about_their_rate() -> None:
    covered = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        x = rng.random((200, 2))
        share = by_name(shares("ab", x, x[:, 0] + x[:, 1], seed))["a"]
        covered.append(share.low <= 0.5 <= share.high)
    assert np.mean(covered) > 0.85, np.mean(covered)


def test_a_choice_is_its_values_in_any_order() -> None:
    rng = np.random.default_rng(4)
    kind = rng.choice([1.0, 2.0, 7.0], 900)
    effect = np.array([5.0, -1.0, 2.0])[np.searchsorted([1.0, 2.0, 7.0], kind)]  # not monotone
    other = rng.standard_normal(900)
    found = by_name(shares(("kind", "other"), np.column_stack((kind, other)), effect + other))
    assert found["kind"].first == pytest.approx(np.var(effect) / (np.var(effect) + 1), abs=0.02)


def test_an_interaction_is_in_the_totals_of_a_grid_and_in_no_first_order() -> None:
    two = vary.parse_variations(["a=-1:1:20", "b=choice(-1,1)", "c=0:1:2"])
    x = vary.values(two, vary.points(two, 80, "grid", 0), (0.0, 0.0, 0.0))
    rows = np.random.default_rng(5).permutation(80)  # the order of the runs says nothing
    found = by_name(shares("abc", x[rows], (x[:, 0] * x[:, 1])[rows]))
    assert (found["a"].total, found["b"].total, found["c"].total) == pytest.approx((1, 1, 0))
    assert max(abs(share.first) for share in found.values()) < 1e-12
    part = shares("abc", x[:-1], (x[:, 0] * x[:, 1])[:-1])
    assert all(math.isnan(share.total) for share in part), "a grid with a hole"


def grid(*levels: int) -> np.ndarray:
    """Return a full grid over 0 to 1, (n, d), the last fastest."""
    axes = [np.linspace(0.0, 1.0, n) for n in levels]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(levels))


def variance(levels: int, power: int) -> float:
    return float(np.var(np.linspace(0.0, 1.0, levels) ** power))


@pytest.mark.parametrize("levels", [(5, 5), (2, 12), (9, 3), (4, 7, 2)])
@pytest.mark.parametrize("missing", [0.0, 0.1, 0.3])
def test_a_grid_has_the_shares_of_its_levels_also_with_holes(
    levels: tuple[int, ...], missing: float
) -> None:
    """3 a^2 + b: 9 Var(a^2) and Var(b) over the levels; a failed run says NaN, or is not there."""
    x = grid(*levels)
    y = 3.0 * x[:, 0] ** 2 + x[:, 1]
    orders = (np.random.default_rng(seed).permutation(len(y)) for seed in range(99))
    holes = (order >= missing * len(y) for order in orders)
    there = next(
        t for t in holes if all(map(np.array_equal, map(np.unique, x[t].T), map(np.unique, x.T)))
    )
    whole = 9.0 * variance(levels[0], 2) + variance(levels[1], 1)
    exact = {"a": 9.0 * variance(levels[0], 2) / whole, "b": variance(levels[1], 1) / whole}
    for found in (
        by_name(shares("abc"[: len(levels)], x, np.where(there, y, math.nan))),
        by_name(shares("abc"[: len(levels)], x[there], y[there])),
    ):
        if 2 * int(there.sum()) < 3 * sum(n - 1 for n in levels) + 2:
            assert all(math.isnan(share.first) for share in found.values()), "too few runs"
            continue
        for name, share in found.items():
            assert share.first == pytest.approx(exact.get(name, 0.0), abs=1e-9), share
            assert share.low == pytest.approx(share.first, abs=1e-6), "nothing is left to err"


def test_an_interaction_errs_by_the_part_of_a_grid_that_is_missing() -> None:
    """ab: both shares 0.2727 on 5 x 5 levels; the interval covers, and is a point without holes."""
    x = grid(5, 5)
    y = x[:, 0] * x[:, 1]
    (exact, low, high) = ((s := shares("ab", x, y)[0]).first, s.low, s.high)
    mean2, own = 0.25, variance(5, 1)
    assert exact == pytest.approx(mean2 * own / (own**2 + 2.0 * mean2 * own)) and low == high
    widths, covered = list[float](), list[bool]()
    for seed in range(40):
        rows = np.random.default_rng(seed).permutation(25)[:20]
        one = by_name(shares("ab", x[rows], y[rows]))["a"]
        widths.append(one.high - one.low)
        covered.append(one.low <= exact <= one.high)
    assert np.mean(covered) > 0.7 and 0.0 < np.mean(widths) < 0.4, (np.mean(covered), widths[:3])


def test_a_part_of_a_grid_has_no_bias_from_what_no_share_explains() -> None:
    """Over random parts of one grid the mean is that of all of it, within 4 standard errors."""
    rng, x = np.random.default_rng(7), grid(6, 6)
    y = np.where(x[:, 0] * 5 % 2 < 1, 0.0, 0.5) + rng.standard_normal(36)
    parts = (rng.permutation(36)[:24] for _ in range(200))
    found = [by_name(shares("ab", x[rows], y[rows])) for rows in parts]
    for name, share in by_name(shares("ab", x, y)).items():
        firsts = [one[name].first for one in found]
        error = np.nanstd(firsts) / math.sqrt(len(firsts))
        assert abs(np.nanmean(firsts) - share.first) < 4.0 * error, (share, np.nanmean(firsts))


@pytest.mark.parametrize(("sampling", "n", "near"), [("sobol", 64, 0.02), ("random", 400, 0.07)])
def test_a_small_share_is_found_beside_a_large_one(sampling: str, n: int, near: float) -> None:
    """3 a^2 + b: 0.9057 and 0.0943; 4 a + 3 b + 2 c + d: 16, 9, 4, 1 of 30."""
    cube = vary.parse_variations([f"{name}=0:1" for name in "abcd"])
    x = vary.values(cube, vary.points(cube, n, sampling, 2), (0.0,) * 4)
    curved = by_name(shares("abcd", x, 3.0 * x[:, 0] ** 2 + x[:, 1]))
    straight = by_name(shares("abcd", x, x @ np.array([4.0, 3.0, 2.0, 1.0])))
    for found, exact in (
        (curved, (0.8 / (0.8 + 1 / 12), 1 / 12 / (0.8 + 1 / 12), 0.0, 0.0)),
        (straight, (16 / 30, 9 / 30, 4 / 30, 1 / 30)),
    ):
        assert [found[name].first for name in "abcd"] == pytest.approx(exact, abs=near)
    product = shares("abcd", x, (x[:, 0] - 0.5) * (x[:, 1] - 0.5))
    assert max(abs(share.first) for share in product) < near


def test_totals_of_the_ishigami_function_on_a_grid() -> None:
    middle = (np.arange(24) + 0.5) / 24 * 2.0 * math.pi - math.pi
    x = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), axis=-1).reshape(-1, 3)
    found = by_name(shares(("x1", "x2", "x3"), x, ishigami(x)))
    assert [found[n].first for n in found] == pytest.approx([0.4424, 0.3139, 0.0], abs=4e-3)
    totals = {name: share.total for name, share in found.items()}
    assert totals == pytest.approx({"x1": 0.5576, "x2": 0.4424, "x3": 0.2437}, abs=5e-3)


def test_what_cannot_be_told_is_not_a_number() -> None:
    x = np.arange(10.0)[:, None]
    for y in (np.ones(10), np.full(10, math.nan)):
        assert math.isnan(shares("a", x, y)[0].first)
    assert math.isnan(shares("a", np.ones((10, 1)), np.arange(10.0))[0].first)
    assert math.isnan(shares("a", np.empty((0, 1)), np.empty(0))[0].first)
    hole = np.where(np.arange(400) % 7, np.arange(400.0), math.nan)
    assert shares("a", np.arange(400.0)[:, None], hole)[0].first > 0.99
