"""Sampling and Riccati equation in portable arithmetic, against identities and against scipy."""

import numpy as np
import pytest
from scipy import linalg

from pcpc.executive.laws.riccati import (
    diagonal,
    eye,
    filter_gain,
    regulator,
    riccati,
    sampled_system,
    solution,
    times,
    transpose,
)


def system(seed: int, n: int, m: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(0.0, 0.6, (n, n)), rng.normal(0.0, 1.0, (n, m))
    return a, b, np.diag(rng.uniform(0.1, 3.0, n)), np.diag(rng.uniform(0.1, 3.0, m))


@pytest.mark.parametrize("seed", range(12))
def test_it_solves_the_riccati_equation_and_stabilises(seed: int) -> None:
    a, b, q, r = system(seed, 2 + seed % 5, 1 + seed % 3)
    lists = [one.tolist() for one in (a, b, q, r)]
    x, k = np.array(riccati(*lists)), np.array(regulator(*lists))
    inner = r + b.T @ x @ b
    again = a.T @ x @ a - a.T @ x @ b @ np.linalg.solve(inner, b.T @ x @ a) + q
    assert np.abs(again - x).max() < 1e-10 * np.abs(x).max(), "residual"
    assert np.abs(x / linalg.solve_discrete_are(a, b, q, r) - 1.0).max() < 1e-6
    assert np.abs(k - np.linalg.solve(inner, b.T @ x @ a)).max() < 1e-10
    assert abs(np.linalg.eigvals(a - b @ k)).max() < 1.0


def test_the_filter_is_the_regulator_of_the_turned_system() -> None:
    a, b, q, r = (one.tolist() for one in system(5, 4, 2))
    gain = filter_gain(transpose(a), transpose(b), q, r)
    ahead = np.array(transpose(regulator(a, b, q, r)))  # A L = K'
    assert np.abs(np.array(times(transpose(a), gain)) - ahead).max() < 1e-12


def test_the_scalar_equation_has_its_closed_form() -> None:
    a, q, r = 1.2, 0.7, 0.3
    half = 0.5 * (r * (a * a - 1.0) + q)  # x^2 - 2 half x - q r = 0
    expected = half + np.sqrt(half * half + q * r)
    assert abs(riccati([[a]], [[1.0]], [[q]], [[r]])[0][0] / expected - 1.0) < 1e-13


@pytest.mark.parametrize("seed", range(4))
def test_sampling_is_the_matrix_exponential(seed: int) -> None:
    rng = np.random.default_rng(seed)
    f, g, period = rng.normal(0.0, 30.0, (4, 4)), rng.normal(0.0, 1.0, (4, 2)), 0.02
    a, b = (np.array(one) for one in sampled_system(f.tolist(), g.tolist(), period))
    whole = linalg.expm(np.block([[f, g], [np.zeros((2, 6))]]) * period)
    assert np.abs(a - whole[:4, :4]).max() < 1e-12 * np.abs(whole).max()
    assert np.abs(b - whole[:4, 4:]).max() < 1e-12 * np.abs(whole).max()


def test_what_has_no_solution_is_refused() -> None:
    with pytest.raises(ValueError, match="stabilising"):
        riccati([[1.5]], [[0.0]], [[1.0]], [[1.0]])
    with pytest.raises(ValueError, match="singular"):
        solution([[1.0, 2.0], [2.0, 4.0]], eye(2))
    assert diagonal([1.0, 2.0]) == [[1.0, 0.0], [0.0, 2.0]]
