"""What varies: distributions against their definitions, points that do not move, seeds."""

import math
import subprocess
import sys

import numpy as np
import pytest

from pcpc.executive.errors import RigError
from pcpc.tools.study.sweep import vary

MANY = (np.arange(20_000) + 0.5) / 20_000


def drawn(text: str, own: float = 7.0) -> np.ndarray:
    variation = vary.parse(f"plant.a={text}")
    return np.array([variation.value(u, own) for u in MANY])


@pytest.mark.parametrize(
    ("text", "mean", "deviation"),
    [
        ("1e-3:3e-3", 2e-3, 2e-3 / math.sqrt(12)),
        ("normal(-2,0.5)", -2.0, 0.5),
        ("lognormal(2,1.3)", 2 * math.exp(math.log(1.3) ** 2 / 2), None),
        ("0:4:5", 2.0, math.sqrt(2)),
        ("choice(1, 5, 3)", 3.0, math.sqrt(8 / 3)),
        ("x0.5:2", 1.25 * 7, 1.5 * 7 / math.sqrt(12)),
        ("xnormal(1,.1)", 7.0, 0.7),
        ("normal(0,1,0,99)", math.sqrt(2 / math.pi), math.sqrt(1 - 2 / math.pi)),
        ("normal(0,1,-99,0)", -math.sqrt(2 / math.pi), math.sqrt(1 - 2 / math.pi)),
    ],
)
def test_values_have_mean_and_deviation(text: str, mean: float, deviation: float | None) -> None:
    found = drawn(text)
    assert found.mean() == pytest.approx(mean, rel=1e-3)
    if deviation is not None:
        assert found.std() == pytest.approx(deviation, rel=3e-3)


def test_the_numbers_of_lognormal_are_the_median_and_the_factor_of_one_deviation() -> None:
    found = drawn("lognormal(2,1.3)")
    assert np.median(found) == pytest.approx(2.0, rel=1e-3)
    assert np.mean((found > 2 / 1.3) & (found < 2 * 1.3)) == pytest.approx(0.6827, abs=1e-3)


def test_truncated_values_stay_within_also_far_out() -> None:
    for low, high in ((8.0, 9.0), (-9.0, -8.0)):
        found = drawn(f"normal(0,1,{low},{high})")
        assert found.min() >= low and found.max() <= high
        assert len(np.unique(found)) > 19_000 and abs(np.median(found)) < 8.1


def test_grid_values_include_both_ends_and_choices_are_equally_frequent() -> None:
    values, counts = np.unique(drawn("-1:1:5"), return_counts=True)
    assert values.tolist() == [-1.0, -0.5, 0.0, 0.5, 1.0] and set(counts) == {4000}
    values, counts = np.unique(drawn("choice(3,1,2,7)"), return_counts=True)
    assert values.tolist() == [1.0, 2.0, 3.0, 7.0] and set(counts) == {5000}
    assert set(drawn("xchoice(1,2)")) == {7.0, 14.0}


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("plant.a", "expected NAME=SPEC"),
        ("=1:2", "expected NAME=SPEC"),
        ("a=3", "expected lo:hi"),
        ("a=1:2:3:4", "expected lo:hi"),
        ("a=2:1", "write the lower bound first"),
        ("a=1:1", "write the lower bound first"),
        ("a=1:2:1", "expected a whole number of 2 or more"),
        ("a=1:2:2.5", "expected a whole number of 2 or more"),
        ("a=1:", "a number is missing"),
        ("a=one:2", "'one' is not a finite number"),
        ("a=.nan:2", "give a number"),
        ("a=1:.inf", "is not a finite number"),
        ("a=1:1e999", "beyond the range"),
        ("a=norml(1,2)", "did you mean normal?"),
        ("a=normal(1)", "1 numbers; expected"),
        ("a=normal(1,2,3)", "truncated: normal(m,s,lo,hi)"),
        ("a=normal(1,0)", "expected more than 0"),
        ("a=normal(1,1,2,2)", "write the lower bound first"),
        ("a=lognormal(1,0.2)", "expected median > 0 and factor > 1"),
        ("a=lognormal(0,2)", "expected median > 0 and factor > 1"),
        ("a=choice(1,1)", "a value is there twice"),
        ("a=choice()", "a number is missing"),
        ("a=choice(yes,no)", "'yes' is not a finite number"),
        ("a=xx1:2", "'x1' is not a finite number"),
    ],
)
def test_what_is_wrong_is_one_line_with_the_option_and_the_cure(option: str, words: str) -> None:
    with pytest.raises(RigError) as error:
        vary.parse(option)
    text = str(error.value)
    assert text.startswith(f"--vary {option}: ") and words in text and "\n" not in text


def test_a_name_varies_once_and_a_factor_needs_something_to_multiply() -> None:
    with pytest.raises(RigError, match=r"^--vary a=1:3: this value is already varied; "):
        vary.parse_variations(["a=1:2", "b=1:2", "a=1:3"])
    with pytest.raises(RigError, match=r"the rig's own value is 0, .*; give lo:hi"):
        vary.parse("a=x1:2").value(0.5, 0.0)


THREE = vary.parse_variations(["a=1:2", "b=normal(0,1)", "c=choice(1,2)"])


@pytest.mark.parametrize("sampling", ["random", "sobol"])
def test_a_point_does_not_depend_on_how_many_there_are(sampling: str) -> None:
    most = vary.points(THREE, 1000, sampling, 5)
    for n in (1, 2, 3, 127, 128, 129, 999):
        assert vary.points(THREE, n, sampling, 5).tobytes() == most[:n].tobytes()
    assert not np.array_equal(most, vary.points(THREE, 1000, sampling, 6))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("sampling", ["random", "lhs", "sobol"])
def test_points_fill_the_open_unit_cube_evenly(sampling: str) -> None:
    found = vary.points(THREE, 500, sampling, 1)
    assert found.shape == (500, 3) and found.min() > 0.0 and found.max() < 1.0
    counts = np.apply_along_axis(lambda u: np.histogram(u, 10, (0, 1))[0], 0, found)
    assert counts.min() > 25 and counts.max() < 80, counts
    if sampling == "lhs":
        assert all(sorted((column * 500).astype(int)) == list(range(500)) for column in found.T)


def test_every_process_makes_the_same_points() -> None:
    code = (
        "from pcpc.tools.study.sweep import vary; import hashlib, sys\n"
        "v = vary.parse_variations(['a=1:2', 'b=normal(0,1)', 'c=choice(1,2)'])\n"
        "for s in ('random', 'lhs', 'sobol'):\n"
        "    print(hashlib.sha256(vary.points(v, 64, s, 9).tobytes()).hexdigest())\n"
    )
    runs = [subprocess.check_output([sys.executable, "-c", code], text=True) for _ in range(2)]
    assert runs[0] == runs[1] and len(set(runs[0].split())) == 3


def test_a_grid_holds_every_combination_once() -> None:
    two = vary.parse_variations(["a=0:1:3", "b=choice(5,6,7,8)"])
    found = vary.values(two, vary.points(two, 12, "grid", 0), (0.0, 0.0))
    assert found.tolist() == [[a, b] for a in (0.0, 0.5, 1.0) for b in (5.0, 6.0, 7.0, 8.0)]
    with pytest.raises(RigError, match="this grid has 12 combinations"):
        vary.points(two, 10, "grid", 0)
    with pytest.raises(RigError, match=r"^--vary b=normal\(0,1\): a grid needs values"):
        vary.grid_size(vary.parse_variations(["a=0:1:3", "b=normal(0,1)"]))


def test_what_cannot_be_drawn_is_one_line() -> None:
    with pytest.raises(RigError, match="0 draws"):
        vary.points(THREE, 0, "random", 0)
    with pytest.raises(RigError, match="sampling sobel: unknown; did you mean sobol"):
        vary.points(THREE, 4, "sobel", 0)


def test_snapped_points_have_the_values_of_their_own_and_one_number_for_each() -> None:
    draws = vary.points(THREE, 100, "random", 3)
    close = vary.snap_to_levels(THREE, draws)
    own = (1.0, 1.0, 1.0)
    assert np.array_equal(vary.values(THREE, close, own), vary.values(THREE, draws, own))
    assert len(np.unique(close[:, 2])) == 2 and np.array_equal(close[:, :2], draws[:, :2])


def test_normal_coordinates_have_values_however_far_out() -> None:
    far = vary.points_of_normal(np.array([[-40.0] * 3, [0.0] * 3, [40.0] * 3]))
    assert far[1].tolist() == [0.5] * 3 and far.min() > 0.0 and far.max() < 1.0
    found = vary.values(THREE, far, (1.0, 1.0, 1.0))
    assert np.isfinite(found).all() and found[:, 2].tolist() == [1.0, 2.0, 2.0]


def test_no_two_draws_of_a_campaign_share_a_noise_seed() -> None:
    for campaign in (0, 1, 2**40):
        seeds = [vary.run_seed(campaign, draw) for draw in range(20_000)]
        assert len(set(seeds)) == len(seeds) and min(seeds) > 0 and max(seeds) < 2**31
        bits = np.array(seeds)[:, None] >> np.arange(31) & 1
        assert abs(bits.mean(axis=0) - 0.5).max() < 0.02, "a bit that hardly changes"
    assert len({vary.run_seed(campaign, 0) for campaign in range(1000)}) == 1000
    with pytest.raises(ValueError, match="is not within"):
        vary.run_seed(0, 2**31 - 1)


def test_the_noise_seeds_are_a_permutation_of_their_range(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vary, "SEED_BITS", 10)
    assert sorted(vary.run_seed(3, draw) for draw in range(1023)) == list(range(1, 1024))
