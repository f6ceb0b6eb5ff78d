"""Least squares of the simulation error, and how sure its estimate is.

    r_kj   = (y_kj(theta) - m_kj)/s_j                      residual of sample k, sensor j        (1)
    theta  minimises the sum of r_kj^2                     (scipy.optimize.least_squares)        (2)
    s_j^2  = mean over k of (y_kj - m_kj)^2                noise, from the residuals of (2)      (3)
    A      = J'J,  g_k = sum over j of J_kj r_kj                                                 (4)
    cov    = A^-1 S A^-1,  S = sum over |l| <= L of (1 - |l|/(L + 1)) sum over k of g_k g_k-l'   (5)
    cov_0  = A^-1                                          were the residuals white              (6)
    theta <- theta - A^-1 J'r,  r_kj = (Q(y_kj) - m_kj)/s_j                                      (7)

(2) is done with s_j of the samples' second differences first (noise.py), over growing parts of the
record (search.py). Then s_j is (3), and (2) is done again. J is by forward differences in the
search and by central ones in what comes after it. An end that leaves a block of samples with more
than its noise has not arrived, and is no estimate.

Rounding of a slow motion is no white noise: at rest a sensor errs by the same part of a count for
seconds, and two runs err alike, so that (2) is biased. Where rounding is all that a sensor's
residuals hold, the model predicts it: Q(y) are the model's own samples, rounded as the sensor and
the bus do. (7) seeks where J'r is 0, which the true theta makes it whatever the motion. Its steps
end in a cycle, as Q is a staircase; their mean is taken. Other sensors keep r of (1) in (7).

A standard error is the larger one of (5) and (6), in which r is (1): both count rounding as noise,
so after (7) they are wider than they need be, by a factor of about two. L follows from the
scores' own correlation (Andrews). Source: Newey and West, A simple, positive semi-definite,
heteroskedasticity and autocorrelation consistent covariance matrix, Econometrica 55 (1987);
Andrews, Econometrica 59 (1991), eq. (6.2), (6.4).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pcpc.tools.study.arrays import Array, Flags
from pcpc.tools.study.fit.noise import Noise, difference_noise, resolution
from pcpc.tools.study.fit.search import (
    Predict,
    Problem,
    bounded_residuals,
    find,
    minimum,
    onward,
    scaled_inverse,
)
from pcpc.tools.study.fit.smooth import smooth_part

Samples = Callable[[Array], tuple[Array, Array]]  # point (p,) -> y, Q(y), each (rows, sensors)

CLOSE = 0.97  # two estimates with a larger correlation are known better together than each
ROUNDED = 1.25  # residuals up to this many times those of rounding alone hold nothing else
TURNS, KEPT = 9, 6  # steps of (7), and how many of the last are averaged
WIDER = 3.0  # times the errors of a smooth part: an end beside the best value is within
LOST = 0.5  # a standard error above this share of the scale: not excited


@dataclass(frozen=True)
class Estimate:
    """An estimate of p parameters from `rows` samples.

    `values`, `errors` (p,): estimate, standard error; `interval` (p, 2) of 95 %; `correlation`
    (p, p); `excited` (p,): False where the record tells nothing, and the start was kept; `noise`
    (sensors,): s_j of (3); `predicted` (rows, sensors); `lag`: L of (5); `inflation` (p,): (5)
    over (6), as standard errors; `before` (p,): the estimate before (7).
    """

    values: Array
    errors: Array
    interval: Array
    correlation: Array
    excited: Flags
    noise: Array
    predicted: Array
    lag: int
    inflation: Array
    evaluations: int
    rows: int
    before: Array
    own: Array = field(default_factory=lambda: np.zeros(0))
    worst: Array = field(default_factory=lambda: np.zeros(0))
    explained: int = 0
    alike: bool = False
    smooth: int = 0

    @property
    def arrived(self) -> bool:
        """Whether no block of the record is left with more than noise, and errors can be told."""
        return self.explained == self.rows and self.smooth > 0


def estimate(
    predict: Predict,
    measured: Array,
    quantum: Array,
    start: Array,
    bounds: Array,
    samples: Samples | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Estimate:
    """Return the estimate; `measured` (rows, sensors), NaN where there is no sample.

    `quantum` (sensors,) of the samples; `start` (p,); `bounds` (p, 2); `samples`: for (7).
    """
    quantum = resolution(measured, quantum)
    scale = np.where(start != 0.0, np.abs(start), 0.1 * np.minimum(np.ptp(bounds, axis=1), 10.0))
    of = Problem(predict, measured, scale, bounds[:, 0] / scale, bounds[:, 1] / scale)
    own = Noise(difference_noise(measured, quantum), quantum)
    noise = own.noise
    floor, rows = quantum / math.sqrt(12.0), len(measured)
    search = find(of, start / scale, own, say)
    z, steps = search.z, search.steps
    if search.rows < rows:
        z, steps = onward(of, search, start / scale, noise, say)
    excited = np.ones(len(z), bool)
    for turn in range(3):
        say(f"the whole record, {of.evaluations} runs so far")
        z, steps = minimum(of, z, rows, noise, steps, 1e-5 if turn else 1e-3, free=excited)
        noise = _noise(of, z, rows, floor, excited)
        _, slope = of.linearised(z, rows, noise, steps, central=turn > 0)
        told = _are_excited(slope, excited)
        if turn and (told == excited).all():
            break
        z, excited = np.where(told, z, start / scale), told
    before = z * scale
    if samples is not None and excited.any():
        say(f"rounding, {of.evaluations} runs so far")
        z = _correct_rounding(of, samples, z, noise, slope, excited, floor)
    found = _with_errors(of, z, rows, noise, slope, excited)
    smooth, unsure = rows, np.zeros(len(z))
    if excited.any() and own.excess(found.predicted, measured)[1] == rows:
        say(f"how smooth the minimum is, {of.evaluations} runs so far")
        smooth, unsure = smooth_part(of, before / scale, noise, steps, excited)
    if smooth < rows:
        found = _widen(found, unsure * scale)
    worst, explained = own.excess(found.predicted, measured)
    return replace(
        found,
        before=before,
        own=own.noise,
        worst=worst,
        explained=explained,
        alike=search.alike,
        smooth=smooth,
    )


def _widen(found: Estimate, errors: Array) -> Estimate:
    """Return an estimate whose errors are at least WIDER times those."""
    least = np.maximum(found.errors, WIDER * errors)
    half = 0.5 * np.ptp(found.interval, axis=1)
    half = np.where(least > found.errors, 1.96 * least, half)[:, None]
    interval = found.values[:, None] + np.concatenate((-half, half), axis=1)
    return replace(found, errors=least, interval=interval)


def _correct_rounding(
    of: Problem,
    samples: Samples,
    z: Array,
    noise: Array,
    slope: Array,
    excited: Flags,
    floor: Array,
) -> Array:
    """Return z after (7); as it was where no sensor only rounds, or (7) leads away."""
    j = slope[..., excited].reshape(-1, excited.sum())
    step = np.linalg.pinv(j)

    def only_round(y: Array) -> Flags:
        return np.asarray(_noise_of(y - of.measured) <= ROUNDED * floor)

    y, rounded = samples(z * of.scale)
    counted, found, now = only_round(y), [], z
    for _ in range(TURNS if counted.any() else 0):
        r = bounded_residuals((np.where(counted, rounded, y) - of.measured) / noise)
        now = now.copy()
        now[excited] -= step @ r.ravel()
        now = np.clip(now, of.low, of.high)
        found.append(now)
        y, rounded = samples(now * of.scale)
    of.evaluations += 1 + len(found)
    mean = np.mean(found[-KEPT:], axis=0) if found else z
    stays = only_round(of.signals(mean[None], len(of.measured))[0])[counted].all()
    return np.asarray(mean) if stays else z


def _noise_of(error: Array) -> Array:
    """Return the rms of residuals (rows, sensors), of the samples that there are."""
    count = np.maximum(np.isfinite(error).sum(axis=0), 1)
    return np.asarray(np.sqrt(np.nansum(error * error, axis=0) / count))


def _noise(of: Problem, z: Array, rows: int, floor: Array, excited: Flags) -> Array:
    """Return (3), of as many degrees of freedom as there are."""
    error = of.signals(z[None], rows)[0] - of.measured
    count = np.isfinite(error).sum(axis=0)
    mean = np.nansum(error * error, axis=0) / np.maximum(count - excited.sum() / error.shape[1], 1)
    return np.maximum(np.sqrt(mean), np.maximum(floor, 1e-300))


def _are_excited(slope: Array, excited: Flags) -> Flags:
    """Return of which parameters the record tells something, (6) against the scale."""
    told = excited.copy()
    while told.any():
        inverse, size = scaled_inverse(slope[..., told])
        errors = np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size
        worst = int(np.argmax(errors))
        if errors[worst] < LOST and np.isfinite(errors[worst]):
            return told
        told[np.flatnonzero(told)[worst]] = False
    return told


def _with_errors(
    of: Problem, z: Array, rows: int, noise: Array, slope: Array, excited: Flags
) -> Estimate:
    from scipy.special import stdtrit

    predicted = of.signals(z[None], rows)[0]
    r = bounded_residuals((predicted - of.measured) / noise)
    p = len(z)
    errors, correlation, inflation, lag = np.full(p, np.inf), np.eye(p), np.ones(p), 0
    if excited.any():
        j = slope[..., excited]
        covariance, plain, lag = covariances(j, r)
        sandwich, white = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(plain))
        errors[excited] = np.maximum(sandwich, white)
        inflation[excited] = sandwich / white
        correlation[np.ix_(excited, excited)] = covariance / np.outer(sandwich, sandwich)
    factor = float(stdtrit(max(rows - excited.sum(), 1), 0.975))
    half = factor * errors
    interval = np.stack((z - half, z + half), axis=1) * of.scale[:, None]
    return Estimate(
        z * of.scale,
        errors * of.scale,
        interval,
        correlation,
        excited,
        noise,
        predicted,
        lag,
        inflation,
        of.evaluations,
        rows,
        z * of.scale,
    )


def covariances(slope: Array, r: Array) -> tuple[Array, Array, int]:
    """Return (5), (6) and L for dr/dz (rows, sensors, p) and r (rows, sensors)."""
    inverse, size = scaled_inverse(slope)
    inverse = inverse / np.outer(size, size)
    scores = np.einsum("kjp,kj->kp", slope, r) @ inverse  # each already in units of z
    rows = len(scores)
    lag = min(_lag(scores), rows // 4)
    total = scores.T @ scores
    for shift in range(1, lag + 1):
        cross = scores[shift:].T @ scores[:-shift]
        total += (1.0 - shift / (lag + 1.0)) * (cross + cross.T)
    return total, inverse, lag


def _lag(scores: Array) -> int:
    """Return L of Andrews for Bartlett's window, of a first-order model of each score."""
    above, below = 0.0, 0.0
    for column in scores.T:
        before, after = column[:-1], column[1:]
        rho = float(before @ after) / max(float(before @ before), 1e-300)
        rho = min(max(rho, -0.98), 0.98)
        variance = float(np.mean((after - rho * before) ** 2)) ** 2
        above += 4.0 * rho**2 * variance / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2)
        below += variance / (1.0 - rho) ** 4
    if below <= 0.0:
        return 0
    return math.ceil(1.1447 * (above / below * len(scores)) ** (1.0 / 3.0))


def close_pairs(correlation: Array, names: Sequence[str]) -> list[tuple[str, str, float]]:
    """Return the pairs of estimates that are nearly one."""
    return [
        (names[i], names[j], float(correlation[i, j]))
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) > CLOSE
    ]
