"""The estimator of `pcpc fit` on models whose answer is known in closed form."""

import numpy as np
import pytest

from pcpc.tools.study.fit.estimate import covariances, estimate
from pcpc.tools.study.fit.noise import Noise, difference_noise, resolution
from pcpc.tools.study.fit.search import Problem
from pcpc.tools.study.fit.smooth import smooth_part

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
    return estimate(predict, measured, np.zeros(measured.shape[1]), np.array(start), bounds, **more)


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
    told, lags = [], []
    for seed in range(seeds):
        white = np.random.default_rng(seed).standard_normal(ROWS)
        r = np.empty(ROWS)
        r[0] = white[0]
        for k in range(1, ROWS):
            r[k] = rho * r[k - 1] + white[k]
        spread.append(r.mean())
        covariance, _, lag = covariances(x, r[:, None])
        told.append(covariance[0, 0])
        lags.append(lag)
    ratio = np.mean(told) / np.var(spread)
    assert 0.7 < ratio < 1.15, f"told {ratio:.2f} of the true variance; a white one tells 0.11"
    of_andrews = 1.1447 * (4.0 * rho**2 * ROWS / (1.0 - rho**2) ** 2) ** (1.0 / 3.0)
    assert 0.85 * of_andrews < np.median(lags) < 1.1 * of_andrews, (np.median(lags), of_andrews)


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
    found = fit(
        noisy(4),
        lambda points, rows: (
            points[:, :1, None] * points[:, 1:, None] * REGRESSORS[None, :rows, :1]
        ),
        start=(1.0, 1.5),
    )
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


TURNING = 300.0  # rad by which the phase of `turning` runs over the record, for a value of 1


def turning(points, rows):
    """Return an oscillation whose frequency is sought: one minimum in an eighth of the record."""
    phase = TURNING * points[:, :1] * T[None, :rows]
    return (points[:, 1:] * np.sin(phase))[..., None]


def test_a_start_that_is_lost_in_an_eighth_of_the_record_is_not_lost_in_less_of_it():
    true = np.array([1.3, 2.0])
    measured = turning(true[None], ROWS)[0]
    measured += 0.02 * np.random.default_rng(1).standard_normal(measured.shape)
    found = fit(measured, turning, start=(1.0, 1.0))
    assert found.arrived and found.explained == ROWS
    assert (np.abs(found.values - true) < 2.0 * found.errors + 1e-3).all(), found.values


def test_a_search_that_is_lost_has_not_arrived_and_its_starts_end_apart():
    def rugged(points, rows):
        phase = TURNING * (1.0 + 0.3 * np.sin(1e6 * points))[..., None] * T[:rows]
        return np.sin(phase).sum(axis=1)[..., None]

    true = np.arange(1.0, 9.0)
    measured = rugged(true[None], ROWS)[0]
    measured += 0.01 * np.random.default_rng(2).standard_normal(measured.shape)
    found = fit(measured, rugged, start=true + 0.1, bounds=np.array([[0.0, 10.0]] * len(true)))
    assert not found.arrived and found.explained < ROWS
    assert not found.alike, "the search is lost, and nothing tells that the model is wrong"


def test_a_model_that_is_wrong_has_not_arrived_and_its_starts_end_alike():
    measured = noisy(7, std=0.01)
    measured[:, 0] += 0.5 * T
    measured[:, 0] += 0.5 * np.sin(40.0 * T)
    found = fit(measured)
    assert not found.arrived and found.worst[0] > 3.0
    assert found.alike


def test_a_record_whose_later_half_is_rough_gives_the_errors_of_its_first():
    def rugged(points, rows):
        y = linear(points, rows)
        y[:, ROWS // 2 :] += np.sign(np.sin(3e4 * points[:, :1, None]))
        return y

    def fitted(predict):
        of = Problem(predict, noisy(8), np.ones(2), BOUNDS[:, 0], BOUNDS[:, 1])
        of.measured += predict(TRUE[None], ROWS)[0] - linear(TRUE[None], ROWS)[0]
        return smooth_part(of, TRUE, np.array([0.1]), np.full(2, 1e-7), np.ones(2, bool))

    assert fitted(linear)[0] == ROWS
    rows, errors = fitted(rugged)
    assert rows == ROWS // 2
    first = REGRESSORS[:rows] / 0.1
    np.testing.assert_allclose(errors, np.sqrt(np.diag(np.linalg.inv(first.T @ first))), rtol=1e-2)


def test_noise_is_that_of_the_samples_whatever_moves_and_rounds():
    draw = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, 4000)
    white = np.sin(5.0 * t) + 0.1 * draw.standard_normal(4000)
    rounded = 1e-3 * np.rint(np.sin(5.0 * t) / 1e-3)
    white[2000] += 50.0  # a jerk
    found = difference_noise(np.stack((white, rounded), axis=1), np.array([0.0, 1e-3]))
    np.testing.assert_allclose(found, [0.1, 1e-3 / np.sqrt(12.0)], rtol=0.05)


def test_the_first_block_with_more_than_noise_is_where_the_model_ends():
    draw = np.random.default_rng(4)
    measured = draw.standard_normal((2000, 2))
    measured[::2, 1] = np.nan
    own = Noise(np.ones(2), np.zeros(2))
    worst, first = own.excess(np.zeros((2000, 2)), measured)
    assert first == 2000 and worst.max() < 1.3, worst
    predicted = np.zeros((2000, 2))
    predicted[1201:1400:2, 1] = 1.5
    worst, first = own.excess(predicted, measured)
    assert first == 1201 and worst[1] > 1.5 > worst[0]
    predicted[1701] = np.nan
    assert own.excess(predicted, measured)[0].min() > 1e6, "a model that diverged explains nothing"


def test_an_encoder_at_rest_may_err_by_half_a_count_and_not_when_it_moves():
    still, moving = np.zeros((200, 1)), 20.0 * np.arange(200.0)[:, None]
    own = Noise(np.array([1.0 / np.sqrt(12.0)]), np.ones(1))
    assert own.excess(still + 0.5, still)[1] == 200
    assert own.excess(moving + 0.5, moving)[1] == 0
    assert own.excess(still + 0.6, still)[1] == 0


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
