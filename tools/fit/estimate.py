"""Least squares of the simulation error, and how sure its estimate is.

    r_kj   = (y_kj(theta) - m_kj)/s_j                      residual of sample k, sensor j        (1)
    theta  minimises the sum of r_kj^2                     (scipy.optimize.least_squares)        (2)
    s_j^2  = mean over k of (y_kj - m_kj)^2                noise, from the residuals of (2)      (3)
    A      = J'J,  g_k = sum over j of J_kj r_kj                                                 (4)
    cov    = A^-1 S A^-1,  S = sum over |l| <= L of (1 - |l|/(L + 1)) sum over k of g_k g_k-l'   (5)
    cov_0  = A^-1                                          were the residuals white              (6)
    theta <- theta - A^-1 J'r,  r_kj = (Q(y_kj) - m_kj)/s_j                                      (7)

(2) is done with s_j of the samples' second differences first, over a growing part of the record: an
integrator that starts far off is a wrong turn at the end of a long record, and not yet one at the
end of a short one. Parts weigh the start as one measurement with an error of 100 %, the whole does
not; it begins where the parts ended, or at the start if that agrees better. Then s_j is (3), and
(2) is done again. J is by forward differences in the search and by central ones in what comes after
it.

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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Predict = Callable[[Array, int], Array]  # points (m, p), rows -> signals (m, rows, sensors)
Samples = Callable[[Array], tuple[Array, Array]]  # point (p,) -> y, Q(y), each (rows, sensors)

FIRST, GROWTH = 0.125, 1.25  # of the record that is fitted first; from one part to the next
TRIAL, NEAR, FAR = 1e-3, 1e-8, 3e-2  # steps of differences, as shares of the scale
SHIFT = 0.03  # rms change of the signals that a step of a difference is to make, in units of s_j
WILD = 1e4  # largest residual, in units of s_j: a model that has diverged is not worse than that
CLOSE = 0.97  # two estimates with a larger correlation are known better together than each
_RIDGE = 1e-13  # a matrix of correlations without rank keeps an inverse, which is large
ROUNDED = 1.25  # residuals up to this many times those of rounding alone hold nothing else
TURNS, KEPT = 9, 6  # steps of (7), and how many of the last are averaged
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
    excited: NDArray[np.bool_]
    noise: Array
    predicted: Array
    lag: int
    inflation: Array
    evaluations: int
    rows: int
    before: Array


@dataclass
class _Problem:
    """(1) in units of the scale: z = theta/scale."""

    predict: Predict
    measured: Array
    scale: Array
    low: Array
    high: Array
    evaluations: int = 0

    def signals(self, z: Array, rows: int) -> Array:
        self.evaluations += len(z)
        return self.predict(np.clip(z, self.low, self.high) * self.scale, rows)

    def linearised(
        self, z: Array, rows: int, noise: Array, steps: Array, *, central: bool
    ) -> tuple[Array, Array]:
        """Return (1) (rows, sensors) and dr/dz (rows, sensors, p), 0 where nothing was measured.

        By central differences, or by forward ones, which cost half and do for a search.
        """
        p = len(z)
        ahead, behind = np.minimum(z + steps, self.high), np.maximum(z - steps, self.low)
        if not central:
            ahead, behind = np.where(ahead > z, ahead, behind), z
        points = np.vstack((z, _one_by_one(z, ahead), _one_by_one(z, behind)))
        y = self.signals(points if central else points[: 1 + p], rows)
        lower = y[1 + p :] if central else y[:1]
        slope = (y[1 : 1 + p] - lower) / (ahead - behind)[:, None, None] / noise
        slope[:, np.isnan(self.measured[:rows])] = 0.0
        r = _bounded((y[0] - self.measured[:rows]) / noise)
        return r, np.moveaxis(np.nan_to_num(slope, nan=0.0, posinf=0.0, neginf=0.0), 0, -1)


def _one_by_one(z: Array, other: Array) -> Array:
    """Return (p, p): z with one of its numbers taken from `other` in each row."""
    return np.where(np.eye(len(z), dtype=bool), other, z)


def _bounded(r: Array) -> Array:
    return np.clip(np.nan_to_num(r, nan=0.0, posinf=WILD, neginf=-WILD), -WILD, WILD)


def resolution(measured: Array, quantum: Array) -> Array:
    """Return the step of each sensor's samples (sensors,): of the bus, or the sensor's own."""
    found = np.array(quantum, float)
    for j, column in enumerate(measured.T):
        levels = np.unique(column[np.isfinite(column)])
        if len(levels) > 1:
            found[j] = max(found[j], float(np.min(np.diff(levels))))
    return found


def difference_noise(measured: Array, quantum: Array) -> Array:
    """Return a first s_j (sensors,): of second differences, and no less than rounding makes.

    The median, because jerks are rare; 0.6745 is that of a normal deviate.
    """
    found = np.empty(measured.shape[1])
    for j, column in enumerate(measured.T):
        present = column[np.isfinite(column)]
        jumps = np.abs(np.diff(present, 2)) if len(present) > 2 else np.zeros(1)
        found[j] = np.median(jumps) / 0.6745 / math.sqrt(6.0)
        least = np.ptp(present) if len(present) else 0.0
        found[j] = max(found[j], quantum[j] / math.sqrt(12.0), 1e-9 * least, 1e-300)
    return found


def estimated(
    predict: Predict, measured: Array, quantum: Array, start: Array, bounds: Array,
    samples: Samples | None = None, say: Callable[[str], None] = lambda _: None,
) -> Estimate:  # fmt: skip
    """Return the estimate; `measured` (rows, sensors), NaN where there is no sample.

    `quantum` (sensors,) of the samples; `start` (p,); `bounds` (p, 2); `samples`: for (7).
    """
    quantum = resolution(measured, quantum)
    scale = np.where(start != 0.0, np.abs(start), 0.1 * np.minimum(np.ptp(bounds, axis=1), 10.0))
    of = _Problem(predict, measured, scale, bounds[:, 0] / scale, bounds[:, 1] / scale)
    noise, z = difference_noise(measured, quantum), start / scale
    floor, rows = quantum / math.sqrt(12.0), len(measured)
    steps = np.full(len(z), TRIAL)
    for part in _parts(rows):
        say(f"{100.0 * part / rows:.0f} % of the record, {of.evaluations} runs so far")
        z, steps = _minimum(of, z, part, noise, steps, 1e-2, prior=start / scale)
    z = _better(of, np.stack((z, start / scale)), noise)
    excited = np.ones(len(z), bool)
    for turn in range(3):
        say(f"the whole record, {of.evaluations} runs so far")
        z, steps = _minimum(of, z, rows, noise, steps, 1e-5 if turn else 1e-3, free=excited)
        noise = _noise(of, z, rows, floor, excited)
        _, slope = of.linearised(z, rows, noise, steps, central=turn > 0)
        told = _told(slope, excited)
        if turn and (told == excited).all():
            break
        z, excited = np.where(told, z, start / scale), told
    before = z * scale
    if samples is not None and excited.any():
        say(f"rounding, {of.evaluations} runs so far")
        z = _unrounded(of, samples, z, noise, slope, excited, floor)
    return replace(_judged(of, z, rows, noise, slope, excited), before=before)


def _unrounded(
    of: _Problem, samples: Samples, z: Array, noise: Array, slope: Array,
    excited: NDArray[np.bool_], floor: Array,
) -> Array:  # fmt: skip
    """Return z after (7); as it was where no sensor only rounds, or (7) leads away."""
    j = slope[..., excited].reshape(-1, excited.sum())
    step = np.linalg.pinv(j)

    def only_round(y: Array) -> NDArray[np.bool_]:
        return np.asarray(_noise_of(y - of.measured) <= ROUNDED * floor)

    y, rounded = samples(z * of.scale)
    counted, found, now = only_round(y), [], z
    for _ in range(TURNS if counted.any() else 0):
        r = _bounded((np.where(counted, rounded, y) - of.measured) / noise)
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


def _noise(of: _Problem, z: Array, rows: int, floor: Array, excited: NDArray[np.bool_]) -> Array:
    """Return (3), of as many degrees of freedom as there are."""
    error = of.signals(z[None], rows)[0] - of.measured
    count = np.isfinite(error).sum(axis=0)
    mean = np.nansum(error * error, axis=0) / np.maximum(count - excited.sum() / error.shape[1], 1)
    return np.maximum(np.sqrt(mean), np.maximum(floor, 1e-300))


def _better(of: _Problem, points: Array, noise: Array) -> Array:
    """Return the one of some points (m, p) that agrees best with the whole record."""
    r = _bounded((of.signals(points, len(of.measured)) - of.measured) / noise)
    return np.asarray(points[np.argmin(np.sum(r * r, axis=(1, 2)))])


def _parts(rows: int) -> list[int]:
    """Return how many rows are fitted, one part after the other, before the whole."""
    count = math.ceil(-math.log(FIRST) / math.log(GROWTH))
    return sorted({max(2, round(rows / GROWTH**n)) for n in range(1, count + 1)})


def _steps(slope: Array) -> Array:
    """Return steps of differences (p,) that change the signals by about SHIFT."""
    change = np.sqrt(np.mean(slope * slope, axis=(0, 1)))
    return np.clip(SHIFT / np.maximum(change, 1e-12), NEAR, FAR)


def _minimum(
    of: _Problem, z: Array, rows: int, noise: Array, steps: Array, tolerance: float,
    *, prior: Array | None = None, free: NDArray[np.bool_] | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Return where (2) is smallest, from `z` on, and steps of differences for there."""
    from scipy.optimize import least_squares

    free = np.ones(len(z), bool) if free is None else free
    if not free.any():
        return z, steps
    last: dict[bytes, tuple[Array, Array]] = {}

    def at(part: Array) -> tuple[Array, Array]:
        nonlocal steps
        if part.tobytes() not in last:
            full = z.copy()
            full[free] = part
            r, slope = of.linearised(full, rows, noise, steps, central=False)
            steps = _steps(slope)
            r, slope = r.ravel(), slope[..., free].reshape(-1, free.sum())
            if prior is not None:
                r = np.concatenate((r, part - prior[free]))
                slope = np.vstack((slope, np.eye(free.sum())))
            last.clear()
            last[part.tobytes()] = r, slope
        return last[part.tobytes()]

    margin = 1e-9 * np.maximum(1.0, np.abs(z))
    begin = np.clip(z, of.low + margin, of.high - margin)[free]
    found = least_squares(
        lambda part: at(part)[0], begin, lambda part: at(part)[1], (of.low[free], of.high[free]),
        method="trf", ftol=tolerance, xtol=1e-12, gtol=1e-10, max_nfev=15,
    )  # fmt: skip
    full = z.copy()
    full[free] = found.x
    return full, steps


def _told(slope: Array, excited: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return of which parameters the record tells something, (6) against the scale."""
    told = excited.copy()
    while told.any():
        part = slope[..., told].reshape(-1, told.sum())
        size = np.sqrt(np.maximum(np.sum(part * part, axis=0), 1e-300))
        inverse = np.linalg.inv((part / size).T @ (part / size) + _RIDGE * np.eye(told.sum()))
        errors = np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size
        worst = int(np.argmax(errors))
        if errors[worst] < LOST and np.isfinite(errors[worst]):
            return told
        told[np.flatnonzero(told)[worst]] = False
    return told


def _judged(
    of: _Problem, z: Array, rows: int, noise: Array, slope: Array, excited: NDArray[np.bool_]
) -> Estimate:
    from scipy.special import stdtrit

    predicted = of.signals(z[None], rows)[0]
    r = _bounded((predicted - of.measured) / noise)
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
        z * of.scale, errors * of.scale, interval, correlation, excited, noise, predicted, lag,
        inflation, of.evaluations, rows, z * of.scale,
    )  # fmt: skip


def covariances(slope: Array, r: Array) -> tuple[Array, Array, int]:
    """Return (5), (6) and L for dr/dz (rows, sensors, p) and r (rows, sensors)."""
    p = slope.shape[-1]
    flat = slope.reshape(-1, p)
    size = np.sqrt(np.maximum(np.sum(flat * flat, axis=0), 1e-300))  # keeps A well scaled
    inverse = np.linalg.inv((flat / size).T @ (flat / size) + _RIDGE * np.eye(p))
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
        for i in range(len(names)) for j in range(i)
        if abs(correlation[i, j]) > CLOSE
    ]  # fmt: skip
