"""Bounds of a probability of failure after a number of runs fixed beforehand.

Clopper and Pearson, Biometrika 26, 1934.
"""

import math


def clopper_pearson(failures: int, runs: int, confidence: float) -> tuple[float, float]:
    """Return the two-sided interval of a probability after a number of runs fixed beforehand.

    It covers with `confidence` at least. (0, 1) after no runs.
    """
    tail = (1.0 - confidence) / 2.0
    return lower_bound(failures, runs, 1.0 - tail), upper_bound(failures, runs, 1.0 - tail)


def upper_bound(failures: int, runs: int, confidence: float) -> float:
    """Return the one-sided upper bound of Clopper and Pearson, for a fixed number of runs."""
    from scipy.special import betaincinv

    check_counts(failures, runs)
    return 1.0 if failures == runs else float(betaincinv(failures + 1, runs - failures, confidence))


def lower_bound(failures: int, runs: int, confidence: float) -> float:
    """Return the one-sided lower bound of Clopper and Pearson, for a fixed number of runs."""
    return 1.0 - upper_bound(runs - failures, runs, confidence)


def runs_needed(p0: float, confidence: float) -> int:
    """Return how many runs without failure show p < p0, if their number is fixed beforehand."""
    return math.ceil(math.log(1.0 - confidence) / math.log1p(-p0))


def check_counts(failures: int, runs: int) -> None:
    """Raise ValueError unless there can be so many failures."""
    if not 0 <= failures <= runs:
        raise ValueError(f"{failures} failures in {runs} runs")
