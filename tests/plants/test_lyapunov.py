"""A toy law whose proof is exact: what the account finds in it, and what it refuses."""

import math
from itertools import pairwise

import numpy as np
import pytest

from pcpc.plants.lyapunov import Account, Constants, Proof, Vector

K, KAPPA, GAMMA, IDEAL = 4.0, 0.05, 20.0, np.array([1.5, -2.0])


def toy(
    period_s: float, rate: float = GAMMA, rest: float = 0.3, for_s: float = 6.0, seed: int = 3
) -> Account:
    """Return the account of r' = -K r + W~'phi + w under W' = rate phi r - kappa rate |r| W."""
    n = round(for_s / period_s)
    t = period_s * np.arange(n)
    phase = np.random.default_rng(seed).uniform(0.0, 6.0, 2)
    phi = np.stack((np.sin(2.0 * t + phase[0]), np.cos(3.0 * t + phase[1])), axis=1)
    w = rest * np.sign(np.sin(t))
    r, weights = np.zeros(n), np.zeros((n, 2))
    r[0] = 2.0
    for k in range(n - 1):
        slope = -K * r[k] + (IDEAL - weights[k]) @ phi[k] + w[k]
        moved = rate * (phi[k] * r[k] - KAPPA * abs(r[k]) * weights[k])
        r[k + 1] = r[k] + period_s * slope
        weights[k + 1] = weights[k] + period_s * moved
    return Account(proof(t, r, weights, w), for_s / 2)


def proof(t: Vector, r: Vector, weights: Vector, w: Vector) -> Proof:
    """Return what the toy's theorem says of any motion of error and weights."""
    lack = IDEAL - weights
    return Proof(
        theorem="toy",
        error_is="|r|",
        t_s=t,
        v=0.5 * r**2 + 0.5 * np.sum(lack**2, axis=1) / GAMMA,
        damping=K * r**2,
        terms={"w": r * w, "leak": KAPPA * np.abs(r) * np.sum(lack * weights, axis=1)},
        error=np.abs(r),
        weights=np.linalg.norm(lack, axis=1),
        rest=np.abs(w),
        constants=Constants(K, KAPPA, float(np.linalg.norm(IDEAL)), 0.3, gamma=GAMMA),
    )


def test_a_network_that_lacks_nothing_ends_at_the_bound_exactly() -> None:
    """Without weights r' = -K r + c, whose limit is c/K: the bound is tight."""
    bound = Constants(damping=K, kappa=1.0, ideal=0.0, c0=0.3).bound()
    assert bound.error == pytest.approx(0.3 / K, rel=1e-12)
    constant = Constants(damping=K, kappa=1.0, ideal=0.0, c0=0.3, leak="constant").bound()
    assert constant.error == pytest.approx(0.3 / K, rel=1e-12)


@pytest.mark.parametrize("leak", ["error", "constant"])
def test_the_right_side_is_negative_beyond_the_bound_and_zero_on_it(leak: str) -> None:
    one = Constants(damping=2.0, kappa=0.3, ideal=4.0, c0=0.7, c1=0.0, leak=leak)
    bound = one.bound()
    error, weights = np.meshgrid(np.linspace(0, 3, 301), np.linspace(0, 12, 301) * bound.weights)
    slope = one.slope(error * bound.error, weights / 4.0, np.full_like(error, one.c0))
    outside = (error > 1.0) | (weights / 4.0 > bound.weights)
    assert (slope[outside] <= 1e-9).all(), slope[outside].max()
    at = np.linspace(0.0, bound.weights, 100_001)
    largest = one.slope(np.full_like(at, bound.error), at, np.full_like(at, one.c0)).max()
    assert largest == pytest.approx(0.0, abs=1e-6), "a smaller ball would do"


def test_both_derivatives_agree_with_the_order_of_the_sampling() -> None:
    found = [toy(period).unexplained for period in (4e-3, 2e-3, 1e-3)]
    assert found[-1] < 0.02, found
    for coarse, fine in pairwise(found):
        assert 1.8 < coarse / fine < 2.2, found


def test_the_toy_stays_inside_all_its_bounds() -> None:
    account = toy(1e-3)
    assert account.holds, [check for check in account.checks() if not check.holds]
    assert (account.proof.v >= 0.0).all()
    assert account.stated.error < account.largest < account.stated.level, "r_b is no level set"
    assert account.failing.mean() < 0.1, "the inequality is tight where |Z~| and Z~ agree"


@pytest.mark.parametrize("factor", [0.0, -1.0, 100.0])
def test_tuning_that_is_not_the_proofs_is_found(factor: float) -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        account = toy(1e-3, factor * GAMMA)
        assert not account.holds, account.unexplained


def test_arbitrary_signals_violate_it() -> None:
    """A bound on r by the supremum of M r' + Kv r of the same r holds for every signal."""
    draw = np.random.default_rng(11)
    t = 1e-2 * np.arange(400)
    kept, tautology = 0, 0
    for _ in range(2000):
        waves = draw.normal(size=(3, 4)) * draw.uniform(0.1, 3.0)
        rates, phases = draw.uniform(0.3, 9.0, (3, 4)), draw.uniform(0.0, 6.0, (3, 4))
        angle = rates[:, :, None] * t + phases[:, :, None]
        r, *weights = np.sum(waves[:, :, None] * np.sin(angle), axis=1)
        right = np.gradient(r, t) + K * r
        tautology += bool(np.abs(r[200:]).max() <= np.abs(right).max() / K + abs(r[0]))
        w = 0.3 * np.sign(np.sin(t))
        kept += Account(proof(t, r, np.stack(weights, axis=1), w), 2.0).holds
    assert tautology == 2000
    assert kept <= 20, f"{kept} of 2000 arbitrary signals pass"


def test_without_leak_or_damping_there_is_no_bound() -> None:
    for one in (Constants(0.0, 0.1, 1.0, 1.0), Constants(1.0, 0.0, 1.0, 1.0)):
        assert one.bound().error == math.inf
