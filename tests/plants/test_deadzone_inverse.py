"""The adaptive deadzone inverse: identities on a map in plain numpy around the compiled law."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from named_law import Law
from numpy.typing import NDArray

from pcpc.plants.deadzone_map.laws import deadzone_inverse as inverse

SETTINGS = {
    "lam": 0.2, "kv": 0.3, "model_c": 0.1875, "r_max": 20.0, "gam": 0.5, "offset_max": 1.0,
    "slope_min": 0.5, "slope_max": 2.0,
}  # fmt: skip
NAMES = ("offset_plus", "slope_plus", "offset_minus", "slope_minus")
TRUE = np.array([0.12, 1.2, 0.3, 0.8])  # c+, m+, c-, m-
NO_REFERENCE = np.zeros(5)


def deadzone(u: float) -> float:
    above, below = TRUE[1] * u - TRUE[0], TRUE[3] * u + TRUE[2]
    return float(above if above > 0.0 else below if below < 0.0 else 0.0)


def estimates(law: Law) -> NDArray[np.float64]:
    return np.array([getattr(law.x, name) for name in NAMES])


def ticks(law: Law, count: int = 400) -> Iterator[tuple[NDArray[np.float64], Any, bool]]:
    """Yield (estimates used for u, outputs, u is beyond the deadzone) of each tick on the map."""
    x1, x2 = 0.0, 0.0
    for k in range(count):
        x_d = [float(np.sin(0.05 * (k + i) + np.pi / 2)) for i in (0, -1, 1)]
        found = law.step([x1, x2, x_d[1], x_d[0], x_d[2]])
        tau = deadzone(found.command)
        yield estimates(law), found, tau != 0.0
        x1, x2 = x2, -0.1875 * x1 / (1.0 + x2 * x2) + x2 + tau


@given(w=st.floats(-5.0, 5.0).filter(lambda w: abs(w) > 1e-6))
def test_with_the_true_estimates_the_deadzone_is_gone(w: float) -> None:
    law = Law(inverse.BLOCK, SETTINGS | {"gam": 0.0})
    for name, value in zip(NAMES, TRUE, strict=True):
        setattr(law.x, name, value)
    inputs = NO_REFERENCE.copy()
    inputs[4] = w  # all else is zero: the reference ahead is w
    found = law.step(inputs)
    assert found.tau_d == w and abs(deadzone(found.command) - w) < 1e-14 * max(1.0, abs(w))


def test_the_prediction_error_is_that_of_the_estimates() -> None:
    law = Law(inverse.BLOCK, SETTINGS)
    before, checked = None, 0
    for th, found, beyond in ticks(law):
        if before is not None:
            used, u, came_through = before
            right = used[0]
            v = np.array([1.0, -u, 0.0, 0.0] if right else [0.0, 0.0, -1.0, -u])
            if came_through:
                told = float((used[1] - TRUE) @ v)
                assert abs(found.prediction_error - told) < 1e-12, (found.prediction_error, told)
                checked += 1
        before = (found.tau_d >= 0.0, th), found.command, beyond
    assert checked > 300


def test_no_step_moves_the_estimates_away_from_the_deadzone() -> None:
    law = Law(inverse.BLOCK, SETTINGS)
    distance, sure, moved = np.inf, False, 0
    for th, _, beyond in ticks(law):
        now = float(np.linalg.norm(th - TRUE))
        if sure:
            assert now <= distance + 1e-15, (now, distance)
            moved += now < distance
        distance, sure = now, beyond
    assert moved > 200, moved


def test_the_error_goes_away_and_stays_without_tuning() -> None:
    tuned, fixed = (
        [abs(y.e) for _, y, _ in ticks(Law(inverse.BLOCK, SETTINGS | {"gam": gam}))]
        for gam in (0.5, 0.0)
    )
    assert max(tuned[300:]) < 0.1 * max(fixed[300:]), (max(tuned[300:]), max(fixed[300:]))


@given(inputs=st.lists(st.tuples(*[st.floats(-5.0, 5.0)] * 5), min_size=2, max_size=20))
def test_the_estimates_stay_in_the_box(inputs: list[tuple[float, ...]]) -> None:
    law = Law(inverse.BLOCK, SETTINGS | {"gam": 2.0})
    for one in inputs:
        law.step(one)
        c_plus, m_plus, c_minus, m_minus = estimates(law)
        assert min(c_plus, c_minus) >= 0.0 and max(c_plus, c_minus) <= 1.0
        assert min(m_plus, m_minus) >= 0.5 and max(m_plus, m_minus) <= 2.0


@pytest.mark.parametrize("bad", [np.nan, 30.0])
def test_the_guard_of_the_inverse_sends_zero_for_good(bad: float) -> None:
    law = Law(inverse.BLOCK, SETTINGS)
    law.step([0.1, 0.2, 0.1, 0.1, 0.1])
    before = estimates(law)
    for x2 in (bad, 0.2):
        found = law.step([0.1, x2, 0.1, 0.1, 0.1])
        assert (found.command, found.diverged) == (0.0, 1.0), found.command
    assert (estimates(law) == before).all()
