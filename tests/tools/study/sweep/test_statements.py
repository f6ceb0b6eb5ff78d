"""Statements: bounds cover at their rate, also of who looks after every block; figures by hand."""

import math

import numpy as np
import pytest
import scipy

from pcpc.executive.errors import RigError
from pcpc.tools.study import binomial
from pcpc.tools.study.sweep import statements as st

REPETITIONS = 1000
SLACK = 4.0 * math.sqrt(0.05 * 0.95 / REPETITIONS)  # four deviations of a rate of 5 %


def counts(p: float, block: int, blocks: int, seed: int = 1) -> np.ndarray:
    """Return the failures after each block of `REPETITIONS` campaigns, (repetitions, blocks)."""
    rng = np.random.default_rng(seed)
    return rng.binomial(block, p, (REPETITIONS, blocks)).cumsum(axis=1)


def ended(statement: st.Statement, p: float, block: int, blocks: int) -> list[tuple[str, int, int]]:
    """Return outcome, failures and runs of campaigns decided after every block."""
    found = []
    for campaign in counts(p, block, blocks).tolist():
        for i, failures in enumerate(campaign, 1):
            outcome = statement.outcome(failures, i * block)
            if outcome != st.OPEN or i == blocks:
                found.append((outcome, failures, i * block))
                break
    return found


def test_bounds_of_a_fixed_number_of_runs_are_those_of_scipy() -> None:
    for failures, runs in ((0, 10), (3, 40), (10, 10), (7, 100_000)):
        exact = scipy.stats.binomtest(failures, runs).proportion_ci(0.9, "exact")
        assert binomial.clopper_pearson(failures, runs, 0.9) == pytest.approx(exact, rel=1e-9)
    assert binomial.clopper_pearson(0, 0, 0.9) == (0.0, 1.0)


def test_failure_free_runs_that_are_needed() -> None:
    assert binomial.runs_needed(1e-3, 0.95) == 2995 and binomial.runs_needed(1e-5, 0.95) == 299_572
    assert binomial.upper_bound(0, 2995, 0.95) < 1e-3 <= binomial.upper_bound(0, 2994, 0.95)
    alone = st.parse("p_fail < 1e-3 at 95% against 0")
    assert alone.without_failure == 2995
    assert alone.bounds(0, 2995)[1] == pytest.approx(binomial.upper_bound(0, 2995, 0.95))
    assert st.parse("p_fail < 1e-3 at 95%").without_failure == 3327


@pytest.mark.parametrize("p", [0.003, 0.03, 0.4])
def test_fixed_intervals_cover_the_truth_at_the_stated_rate(p: float) -> None:
    covered = [
        low <= p <= high
        for failures in counts(p, 400, 1)[:, 0].tolist()
        for low, high in [binomial.clopper_pearson(failures, 400, 0.95)]
    ]
    assert np.mean(covered) >= 0.95 - SLACK, np.mean(covered)


@pytest.mark.parametrize("p", [0.002, 0.01, 0.2])
def test_bounds_cover_the_truth_at_all_looks_at_once(p: float) -> None:
    """p0 is the truth: to hold is a bound below it, to be refuted one above it (tested below)."""
    statement = st.Statement(p, 0.95, p / 10.0)
    high_missed = low_missed = 0
    for campaign in counts(p, 20, 150).tolist():
        outcomes = {statement.outcome(k, 20 * i) for i, k in enumerate(campaign, 1)}
        high_missed += st.HOLDS in outcomes
        low_missed += st.REFUTED in outcomes
    assert max(low_missed, high_missed) <= (0.05 + SLACK) * REPETITIONS, (low_missed, high_missed)
    assert low_missed + high_missed > 0.01 * REPETITIONS, "bounds that say hardly anything"


def test_fixed_intervals_do_not_stand_repeated_looks() -> None:
    """The reason for the others: whoever looks after every block is wrong three times as often."""
    looks = [(i, k) for row in counts(0.01, 20, 150)[:400].tolist() for i, k in enumerate(row, 1)]
    missed = np.array([binomial.upper_bound(k, 20 * i, 0.95) < 0.01 for i, k in looks])
    assert missed.reshape(400, -1).any(axis=1).mean() > 0.15


@pytest.mark.parametrize("option", ["p_fail < 0.02 at 95%", "p_fail < 0.02 at 95% against 0.008"])
def test_the_sequential_test_errs_no_more_often_than_stated(option: str) -> None:
    statement = st.parse(option)
    at_p0 = [outcome for outcome, *_ in ended(statement, statement.p0, 10, 400)]
    at_p1 = [outcome for outcome, *_ in ended(statement, statement.p1, 10, 400)]
    assert at_p0.count(st.HOLDS) <= (0.05 + SLACK) * REPETITIONS
    given_up = at_p1.count(st.NOT_SHOWN) + at_p1.count(st.REFUTED)
    assert given_up <= (0.05 + SLACK) * REPETITIONS
    assert at_p1.count(st.HOLDS) > 0.9 * REPETITIONS
    far = [outcome for outcome, *_ in ended(statement, 4.0 * statement.p0, 200, 20)]
    assert far.count(st.HOLDS) == 0 and far.count(st.REFUTED) > 0.2 * REPETITIONS, set(far)
    assert at_p0.count(st.REFUTED) <= (0.05 + SLACK) * REPETITIONS


@pytest.mark.parametrize("p", [0.001, 0.005, 0.02, 0.06])
def test_bounds_cover_the_truth_where_the_campaign_ended(p: float) -> None:
    statement = st.parse("p_fail < 0.02 at 95%")
    low, high = zip(
        *(statement.bounds(k, n) for _, k, n in ended(statement, p, 8, 400)), strict=True
    )
    assert np.mean(np.array(low) > p) <= 0.05 + SLACK
    assert np.mean(np.array(high) < p) <= 0.05 + SLACK


@pytest.mark.parametrize(("percent", "some"), [(80.0, 1), (95.0, 1), (99.9, 2)])
def test_the_bound_is_where_the_test_turns(percent: float, some: int) -> None:
    """At each confidence: only at 95 % is the share of false statements that of giving up."""
    statement = st.parse(f"p_fail < 0.01 at {percent}%")
    for failures in (0, some, 5):
        first = next(n for n in range(failures, 9000) if statement.bounds(failures, n)[1] < 0.01)
        assert statement.outcome(failures, first) == st.HOLDS
        assert statement.outcome(failures, first - 1) != st.HOLDS
        last = max(
            (n for n in range(failures, 900) if statement.bounds(failures, n)[0] > 0.01), default=0
        )
        assert (last > 0) is (failures > 0)
        if last:
            assert statement.outcome(failures, last) == st.REFUTED
            assert statement.outcome(failures, last + 1) != st.REFUTED
        upper = statement.bounds(failures, 400)[1]
        turning = st.Statement(upper, percent / 100.0, upper / 10).likelihood(failures, 400)
        assert turning == pytest.approx(-math.log(1.0 - percent / 100.0))


@pytest.mark.parametrize("p0", [0.01, 0.1, 0.4])
def test_a_rate_a_little_above_the_stated_one_is_refuted_and_one_below_never(p0: float) -> None:
    statement = st.Statement(p0, 0.95, p0 / 10.0)
    for times in (1.2, 1.5, 2.0):
        runs = next(
            n
            for n in range(500, 200_000, 500)
            if statement.bounds(round(times * p0 * n), n)[0] > p0
        )
        failures = round(times * p0 * runs)
        assert statement.outcome(failures, runs) == st.REFUTED, (times, failures, runs)
        assert "is refuted at 95 %" in statement.text(failures, runs)
        assert statement.outcome(round(0.9 * p0 * runs), runs) != st.REFUTED


def test_bounds_where_all_runs_fail_and_where_none_was_made() -> None:
    assert st.anytime_bounds(0, 0, 0.95) == (0.0, 1.0)
    assert st.anytime_bounds(1, 1, 0.95) == (pytest.approx(0.05 * 0.5), 1.0)  # (3): 1/2 over p
    for ratio in (2.0, 10.0, math.inf):
        for runs in (1, 10, 1000):
            for failures in range(0, runs + 1, max(runs // 10, 1)):
                low, high = st.anytime_bounds(failures, runs, 0.95, ratio)
                assert 0.0 <= low <= failures / runs <= high <= 1.0, (failures, runs, ratio)


def test_outcomes_in_words() -> None:
    statement = st.parse("p_fail < 1e-3 at 95%")
    assert statement.text(0, 3327) == (
        "p_fail < 1e-3 holds at 95 %: 0 failures in 3,327 runs, bound 9.999e-4; "
        "3,327 were needed without failure"
    )
    assert statement.text(30, 3000) == (
        "p_fail < 1e-3 is refuted at 95 %: 30 failures in 3,000 runs, p_fail is above 4.576e-3"
    )
    assert statement.text(0, 1) == (
        "p_fail < 1e-3 is open after 0 failures in 1 run: bound 0.9548; "
        "about 3,326 more to show it, if it continues like this; "
        "power: shown by 95 % of campaigns if p_fail is 1e-4 or less"
    )
    assert statement.text(3, 500) == (
        "p_fail < 1e-3 is not shown: 3 failures in 500 runs, p_fail <= 1e-4 is excluded at 95 %; "
        "p_fail is above 2.8e-4 and below 0.02187, each at 95 %; "
        "power: shown by 95 % of campaigns if p_fail is 1e-4 or less"
    )
    alone = st.parse("p_fail(peak error (slew)) < 1e-3 at 99.9% against 0")
    assert alone.requirement == "peak error (slew)"
    assert alone.text(1, 10) == (
        "p_fail(peak error (slew)) < 1e-3 is not shown: 1 failure in 10 runs, "
        "and the test allowed for none"
    )
    assert alone.text(0, 10).endswith("power: shown for sure if p_fail is 0 alone")


def test_few_failures_refute_nothing_though_they_are_unlikely_at_p0() -> None:
    """0 in 1,000 at p0 = 0.02 is evidence of another p, and that is a smaller one."""
    near = st.parse("p_fail < 0.02 at 95% against 0.019")
    assert st._log_mixture(0, 1000, 0.02) > math.log(20.0)
    assert near.outcome(0, 1000) == st.OPEN and near.outcome(3, 1000) == st.OPEN
    assert near.outcome(60, 1000) == st.REFUTED


@pytest.mark.parametrize("p", [0.001, 0.002])
def test_the_power_that_is_told_is_that_of_campaigns(p: float) -> None:
    statement = st.parse("p_fail < 0.02 at 95%")
    outcomes = [outcome for outcome, *_ in ended(statement, p, 8, 400)]
    assert outcomes.count(st.HOLDS) >= (0.95 - SLACK) * REPETITIONS, statement.power_text


@pytest.mark.parametrize(
    ("counts", "outcome"),
    [
        ((0, 332, 0), st.HOLDS),
        ((0, 300, 40), st.NOT_SHOWN),
        ((0, 2000, 1), st.HOLDS),
        ((0, 0, 100), st.NOT_SHOWN),
        ((0, 10, 1), st.OPEN),
        ((20, 100, 0), st.REFUTED),
        ((20, 100, 100), st.REFUTED),
        ((20, 100, 3000), st.NOT_SHOWN),
        ((0, 0, 0), st.OPEN),
    ],
)
def test_runs_that_were_not_judged_count_against_either_outcome(
    counts: tuple[int, int, int], outcome: str
) -> None:
    """As failures before it holds, as none before it is refuted."""
    statement = st.parse("p_fail < 0.01 at 95%")
    assert statement.outcome(*counts) == outcome
    failures, runs, unjudged = counts
    if unjudged:
        low = statement.bounds(failures, runs + unjudged)[0]
        high = statement.bounds(failures + unjudged, runs + unjudged)[1]
        said = {st.HOLDS: high, st.REFUTED: low, st.OPEN: high}.get(outcome, low)
        assert st.bound_text(said) in statement.text(*counts)
        assert st.count_text(runs + unjudged, "run") in statement.text(*counts)
        assert f"{unjudged:,} not judged, counted as" in statement.text(*counts)


@pytest.mark.parametrize(("failures", "runs"), [(0, 0), (0, 1500), (1, 1900), (0, 3326)])
def test_the_announced_number_of_runs_decides(failures: int, runs: int) -> None:
    statement = st.parse("p_fail < 1e-3 at 95%")
    more = statement.more(failures, runs)
    rate = failures / runs if runs else 0.0
    total = runs + more
    likelihood = rate * total * statement._failed + (1 - rate) * total * statement._clean
    assert likelihood >= math.log(20.0) * 0.999 or likelihood <= math.log(0.05) * 0.999


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("p_fail", "expected p_fail < 1e-3 at 95%"),
        ("p_fail > 1e-3 at 95%", "expected p_fail < 1e-3 at 95%"),
        ("p_fail < 1e-3", "expected p_fail < 1e-3 at 95%"),
        ("p_fail() < 1e-3 at 95%", "expected p_fail < 1e-3 at 95%"),
        ("p_fail < few at 95%", "few is not a number"),
        ("p_fail < 2 at 95%", "is no probability"),
        ("p_fail < 0 at 95%", "is no probability"),
        ("p_fail < 1e-3 at 100%", "expected 50% or more, below 100%"),
        ("p_fail < 1e-3 at 0.95%", "expected 50% or more"),
        ("p_fail < 1e-3 at 95% against 1e-3", "expected 0 or more, below 0.001"),
    ],
)
def test_a_wrong_statement_is_one_line_with_its_cure(option: str, words: str) -> None:
    with pytest.raises(RigError) as error:
        st.parse(option)
    assert str(error.value).startswith(f"--until '{option}': ") and words in str(error.value)


def test_more_failures_than_runs_are_refused() -> None:
    with pytest.raises(ValueError, match="3 failures in 2 runs"):
        binomial.upper_bound(3, 2, 0.95)
    with pytest.raises(ValueError, match="-1 failures"):
        st.anytime_bounds(-1, 2, 0.95)
