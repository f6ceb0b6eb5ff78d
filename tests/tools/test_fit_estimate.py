"""The estimator of `pcpc fit` on models whose answer is known in closed form."""

import numpy as np
import pytest

from pcpc.tools.fit.estimate import covariances, estimated, resolution

ROWS = 400
BOUNDS = np.array([[-1e3, 1e3]] * 2)
T = np.linspace(0.0, 1.0, ROWS)
REGRESSORS = np.stack((1.0 + T, np.sin(9.0 * T)), axis=1)  # of an acceleration: torque, friction
TRUE = np.array([2.0, -0.7])


def linear(points, rows):
    return np.einsum("rp,mp->mr", REGRESSORS[:rows], points)[..., None]


def noisy(seed, std=0.1):
    return linear(TRUE[None], ROWS)[0] + std * np.random.default_rng(seed).standard_normal(
        (ROWS, 1)
    )


def fit(measured, predict=linear, start=(1.0, -1.0), bounds=BOUNDS, **more):
    return estimated(
        predict, measured, np.zeros(measured.shape[1]), np.array(start), bounds, **more
    )


def test_a_linear_model_gives_the_least_squares_estimate_and_its_covariance():
    measured = noisy(1)
    found = fit(measured)
    expected, left, *_ = np.linalg.lstsq(REGRESSORS, measured[:, 0], rcond=None)
    covariance = left[0] / (ROWS - 2) * np.linalg.inv(REGRESSORS.T @ REGRESSORS)
    np.testing.assert_allclose(found.values, expected, rtol=1e-6)
    plain = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.errors / np.maximum(found.inflation, 1.0), plain, rtol=1e-3)
    assert found.noise[0] == pytest.approx(np.sqrt(left[0] / (ROWS - 2)), rel=1e-3)


def test_the_covariance_of_correlated_residuals_is_that_of_their_generator():
    rho, seeds, spread = 0.8, 400, []
    x = np.ones((ROWS, 1, 1))
    told = []
    for seed in range(seeds):
        white = np.random.default_rng(seed).standard_normal(ROWS)
        r = np.empty(ROWS)
        r[0] = white[0]
        for k in range(1, ROWS):
            r[k] = rho * r[k - 1] + white[k]
        spread.append(r.mean())
        told.append(covariances(x, r[:, None])[0][0, 0])
    ratio = np.mean(told) / np.var(spread)
    assert 0.7 < ratio < 1.15, f"told {ratio:.2f} of the true variance; a white one tells 0.11"


def test_95_percent_intervals_hold_95_percent_of_the_time():
    inside = np.zeros(2)
    seeds = 300
    for seed in range(seeds):
        found = fit(noisy(seed))
        inside += (found.interval[:, 0] < TRUE) & (found.interval[:, 1] > TRUE)
    assert (inside >= 0.91 * seeds).all(), f"{inside} of {seeds}; 0.91 is 3.2 deviations below 0.95"
    assert (inside <= 0.987 * seeds).all(), f"{inside} of {seeds}: the intervals are too wide"


def test_a_parameter_without_effect_is_told_and_keeps_its_start():
    def blind(points, rows):
        return linear(np.stack((points[:, 0], np.full(len(points), TRUE[1])), axis=1), rows)

    found = fit(noisy(3), blind)
    assert found.excited.tolist() == [True, False]
    assert found.values[1] == -1.0
    assert found.values[0] == pytest.approx(2.0, abs=0.05)


def test_two_parameters_that_act_alike_are_not_told_apart():
    found = fit(noisy(4), lambda points, rows: points[:, :1, None] * points[:, 1:, None]
                * REGRESSORS[None, :rows, :1], start=(1.0, 1.5))  # fmt: skip
    assert found.excited.sum() == 1, "of a product only one factor can be had"


def test_samples_that_are_missing_weigh_nothing():
    measured = noisy(5)
    measured[::3] = np.nan
    there = np.isfinite(measured[:, 0])
    expected, *_ = np.linalg.lstsq(REGRESSORS[there], measured[there, 0], rcond=None)
    np.testing.assert_allclose(fit(measured).values, expected, rtol=1e-6)


def test_an_estimate_stays_within_its_bounds():
    found = fit(noisy(6), bounds=np.array([[0.0, 1.5], [-1e3, 1e3]]))
    assert 1.5 - 1e-6 < found.values[0] <= 1.5


def test_a_correction_of_rounding_that_leads_away_is_not_taken():
    measured = encoded(TRUE)[1]

    def wrong(point):
        y, rounded = encoded(point)
        return y, rounded + 10.0 * COUNT

    found = fit(measured, two_sensors, samples=wrong)
    np.testing.assert_array_equal(found.values, found.before)
    assert np.abs(fit(measured, two_sensors, samples=encoded).values - found.before).max() > 0.0


def test_a_search_that_got_lost_in_the_parts_begins_again_at_the_start():
    rough = round(0.85 * ROWS)  # behind the longest part

    def rugged(points, rows):
        y = linear(points, rows)
        y[:, rough:] = np.sin(300.0 * y[:, rough:])
        return y

    measured = rugged(TRUE[None], ROWS)[0]
    measured[:rough, 0] += 0.05 * REGRESSORS[:rough, 0]  # misleads the parts, by 0.05
    found = fit(measured, rugged, start=TRUE * (1.0 + 1e-4))
    assert np.abs(found.values - TRUE).max() < 5e-3, found.values


def test_the_step_of_counts_is_found_in_the_samples():
    counts = 0.25 * np.round(np.random.default_rng(1).standard_normal((100, 1)) * 8.0)
    assert resolution(counts, np.array([1e-6]))[0] == pytest.approx(0.25)


COUNT, STANDS, GYRO_STD = 0.25, 300, 0.1  # of an encoder; rows at rest at either end


def two_sensors(points, rows=2 * STANDS + ROWS):
    """Return the angle of a move from rest to rest, (points, rows, 2), and its noisy copy."""
    s = np.clip((np.arange(rows) - STANDS) / ROWS, 0.0, 1.0)
    regressors = np.stack((1.0 + 4.0 * s, np.sin(3.0 * s)), axis=1)
    return np.repeat(np.einsum("rp,mp->mr", regressors, points)[..., None], 2, axis=2)


def encoded(point):
    y = two_sensors(point[None])[0]
    return y, np.stack((COUNT * np.rint(y[:, 0] / COUNT), y[:, 1]), axis=1)


def outside(seeds, **more):
    """Return how many of the estimates lie outside of their intervals, and mean errors."""
    missed, errors = np.zeros(2), []
    for seed in range(seeds):
        measured = encoded(TRUE)[1]
        measured[:, 1] += GYRO_STD * np.random.default_rng(seed).standard_normal(len(measured))
        found = fit(measured, two_sensors, **more)
        missed += np.abs(found.values - TRUE) > found.interval[:, 1] - found.values
        errors.append(found.values - TRUE)
    return missed, np.abs(errors).mean(axis=0)


def test_an_encoder_at_rest_does_not_pull_the_estimate_to_the_middle_of_its_count():
    missed, errors = outside(60, samples=encoded)
    plain_missed, plain_errors = outside(60)
    assert missed.max() <= 7, f"{missed} of 60 outside; 7 is what 5 % make in 1 of 100 cases"
    assert plain_missed.max() > 30, f"without its rounding modelled: {plain_missed} of 60"
    assert (errors < 0.5 * plain_errors).all(), f"{errors} against {plain_errors}"
