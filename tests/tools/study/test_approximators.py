"""Approximators: Jacobians, identities, two derivations, and equal bits in both modes."""

import math
import warnings
from typing import Any

import every_approximator
import numpy as np
import pytest
from interpreting import interpreted

from pcpc.executive.laws.approximators import activations
from pcpc.tools.study.book.approximators import backprop, cmac, fuzzy, jumps, rbf, rvfl
from pcpc.tools.study.book.approximators.family import (
    Approximator,
    Cmac,
    Fuzzy,
    Grid,
    TwoLayer,
    rbf_net,
    rvfl_net,
    triangle_net,
)

GRID = Grid((-1.0, -2.0), (1.0, 1.0), (5, 6))
POINTS = np.random.default_rng(5).uniform((-1.3, -2.4), (1.3, 1.4), (40, 2))
INSIDE = np.random.default_rng(6).uniform((-1.0, -2.0), (1.0, 1.0), (40, 2))
FAMILY = {
    "two_layer": lambda: TwoLayer(2, 7, 3, seed=1),
    "augmented": lambda: TwoLayer(2, 7, 3, seed=1, c=0.2, count=2),
    "rvfl": lambda: rvfl_net(GRID.low, GRID.high, 7, 3, seed=1),
    "rbf": lambda: rbf_net(GRID, 3),
    "cmac": lambda: Cmac(GRID, 3),
    "spline": lambda: Cmac(GRID, 3, order=4),
    "fuzzy_triangle": lambda: triangle_net(GRID, 3),
    "fuzzy": lambda: Fuzzy(GRID, 3),
}


def made(name: str) -> Approximator:
    """Return a net with random output weights."""
    net = FAMILY[name]()
    w, _ = net.weights()
    w[:] = np.random.default_rng(2).normal(size=w.shape)
    return net


def slope_of(function: Any, at: np.ndarray, h: float = 1e-6) -> np.ndarray:
    """Return the central difference quotients of a vector function, one column an element."""
    columns = []
    for i in range(at.size):
        before = at.flat[i]
        at.flat[i] = before + h
        up = function()
        at.flat[i] = before - h
        down = function()
        at.flat[i] = before
        columns.append((up - down) / (2.0 * h))
    return np.array(columns).T


def test_every_family_runs_in_a_step_with_the_same_bits_compiled_and_interpreted() -> None:
    assert interpreted("every_approximator", "t.digest()") == every_approximator.digest()


@pytest.mark.parametrize("name", FAMILY)
def test_the_gradient_is_that_of_half_the_squared_error(name: str) -> None:
    net, worst = made(name), 0.0
    desired = np.array((0.4, -1.0, 0.2))
    for x in INSIDE[:5]:
        dw, dv = net.gradient(x, desired - net.eval(x))
        w, v = net.weights()
        for found, at in ((dw, w), (dv, v)):
            exact = slope_of(lambda x=x: 0.5 * np.sum((desired - net.eval(x)) ** 2), at)
            worst = max(worst, np.abs(found.ravel() + exact).max(initial=0.0))
    assert worst < 5e-9, f"{name}: -gradient differs by {worst:.1e}"


@pytest.mark.parametrize("kind", range(4), ids=activations.NAMES[:4])
def test_the_slope_of_an_activation_is_its_derivative(kind: int) -> None:
    z, h = np.linspace(-4.0, 4.0, 81), 1e-6
    value = np.array([activations.activate(kind, point) for point in z])
    up = np.array([activations.activate(kind, point + h)[0] for point in z])
    down = np.array([activations.activate(kind, point - h)[0] for point in z])
    error = np.abs((up - down) / (2.0 * h) - value[:, 1]).max()
    assert error < 1e-9, f"{activations.NAMES[kind]}: {error:.1e}"
    exact = (1 / (1 + np.exp(-z)), np.tanh(z), 2 / (1 + np.exp(-z)) - 1, np.exp(-z * z))[kind]
    assert np.abs(value[:, 0] - exact).max() < 1e-15


def test_the_hard_limit_is_a_right_continuous_step_without_slope() -> None:
    found = [activations.activate(activations.HARD_LIMIT, z) for z in (-1e-300, 0.0, -0.0, 3.0)]
    assert found == [(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (1.0, 0.0)]


def test_the_jacobian_of_the_hidden_layer_is_zero_in_the_row_of_the_threshold() -> None:
    net = made("two_layer")
    _, v = net.weights()
    for x in POINTS[:5]:
        phi, jac = net.hidden(x)
        slopes = slope_of(lambda x=x: net.hidden(x)[0], v[0])  # dz/dV_0j = 1
        assert phi[0] == 1.0 and not jac[0].any()
        assert np.abs(jac - slopes).max() < 1e-9, f"{np.abs(jac - slopes).max():.1e}"


def test_the_compiled_rule_is_one_step_down_the_gradient() -> None:
    net, eta = made("two_layer"), 0.1
    (w, v), x, desired = net.weights(), POINTS[0], np.array((0.4, -1.0, 0.2))
    error = desired - net.eval(x)
    dw, dv = net.gradient(x, error)
    s, z, slope, b = np.zeros(8), np.zeros(7), np.zeros(7), np.zeros(7)
    tuned_w, tuned_v = w.copy(), v.copy()
    backprop.hidden(activations.LOGISTIC, x, tuned_v, z, s, slope)
    backprop.tune(eta, eta, error, x, s, slope, b, tuned_w, tuned_v)
    net.step(eta * dw, eta * dv)
    difference = max(np.abs(tuned_w - w).max(), np.abs(tuned_v - v).max())
    assert difference < 1e-15, f"{difference:.1e}"


def test_hebbian_tuning_follows_its_equation_and_is_bounded_only_by_leak_or_limit() -> None:
    x, e, f, g = np.array((0.3, -0.6)), np.array((0.5, 0.1, -0.2)), 0.01, 0.05
    net = made("two_layer")
    (w, v), (s, _) = net.weights(), net.hidden(x)
    by_hand = v + g * (np.outer((1.0, *x), s[1:]) - 0.2 * v), w + f * np.outer(s, e)
    net.hebbian(x, e, f, g, leak=0.2)
    assert np.abs(v - by_hand[0]).max() < 1e-15 and np.abs(w - by_hand[1]).max() < 1e-15
    for _ in range(2000):
        net.hebbian(x, e, 0.0, g, leak=0.2)
    settled = np.linalg.norm(v)
    bound = math.hypot(1.0, *x) * math.sqrt(7.0) / 0.2  # |[1; x]| |sigma| / leak
    assert settled < bound, f"|V| = {settled} with a leak"
    for _ in range(50):
        net.hebbian(x, e, 0.0, g, limit=3.0)
    assert np.linalg.norm(v) <= 3.0 + 1e-12, f"|V| = {np.linalg.norm(v)} with a limit of 3"
    with pytest.warns(UserWarning, match=r"\|V\| grows without bound"):
        net.hebbian(x, e, f, g)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(2000):
            net.hebbian(x, e, 0.0, g)
    assert np.linalg.norm(v) > 100.0, f"|V| = {np.linalg.norm(v)} with neither"


@pytest.mark.parametrize("name", ["cmac", "spline", "fuzzy_triangle", "fuzzy"])
def test_the_basis_is_a_partition_of_unity_everywhere(name: str) -> None:
    net = made(name)
    sums = [net.hidden(x)[0].sum() - 1.0 for x in (*POINTS, np.array((9.0, -9.0)))]
    assert np.abs(sums).max() < 1e-15, f"{name}: {np.abs(sums).max():.1e}"
    assert min(net.hidden(x)[0].min() for x in POINTS) >= 0.0


@pytest.mark.parametrize("name", ["cmac", "spline"])
def test_the_output_by_index_is_that_of_the_whole_basis(name: str) -> None:
    net = made(name)
    assert isinstance(net, Cmac)
    worst = max(np.abs(net.eval(x) - Approximator.eval(net, x)).max() for x in POINTS)
    assert worst < 1e-14, f"{worst:.1e}"
    index, _ = net.touched(POINTS[0])
    assert len(set(index)) == net.order**2, f"{len(set(index))} nodes touched"


def test_tuning_by_index_moves_only_the_nodes_touched() -> None:
    net = made("cmac")
    assert isinstance(net, Cmac)
    (w, _), x, e = net.weights(), POINTS[3], np.array((1.0, 2.0, 3.0))
    expected = w + 0.3 * np.outer(net.hidden(x)[0], e)
    index, value = net.touched(x)
    cmac.tune(0.3, index, value, len(index), e, w)
    assert np.abs(w - expected).max() < 1e-15


def test_an_input_that_is_no_number_gives_no_number_at_safe_indices() -> None:
    net = made("spline")
    assert isinstance(net, Cmac)
    for bad in (math.nan, math.inf, -math.inf):
        index, value = net.touched(np.array((bad, 0.1)))
        assert index.min() >= 0 and index.max() < net.nodes, f"{bad}: {index}"
        assert np.isnan(value).all() == math.isnan(bad), f"{bad}: {value}"


@pytest.mark.parametrize("order", [2, 4])
def test_the_polynomials_by_index_are_the_spline_recursion(order: int) -> None:
    low, d, count = -1.0, 0.4, 8
    t = low + d * (np.arange(count + order) - (order - 1))
    b, values = np.zeros(count + order - 1), np.zeros(order)
    for x in np.linspace(low, low + d * (count - order + 1), 97, endpoint=False):
        cmac.recursion(order, float(x), t, b)
        expected = np.zeros(count)
        first = cmac.axis(order, float(x), low, d, count, values, 0)
        expected[first : first + order] = values
        assert np.abs(b[:count] - expected).max() < 5e-15, f"order {order} at {x}"


def test_triangles_are_the_closed_form() -> None:
    net, centres = Cmac(Grid((-1.0,), (1.0,), (5,)), 1), np.linspace(-1.0, 1.0, 5)
    for x in np.linspace(-1.0, 1.0, 41):
        expected = np.maximum(0.0, 1.0 - np.abs(x - centres) / 0.5)
        assert np.abs(net.hidden([x])[0] - expected).max() < 1e-15, f"at {x}"


def test_a_fuzzy_system_of_triangles_on_a_full_grid_is_a_cmac() -> None:
    both = made("fuzzy_triangle"), made("cmac")
    worst = max(np.abs(both[0].hidden(x)[0] - both[1].hidden(x)[0]).max() for x in POINTS)
    assert worst < 1e-15, f"{worst:.1e}"


def test_radial_basis_functions_are_gaussians_with_one_sided_edges() -> None:
    net = rbf_net(Grid((-1.0,), (1.0,), (5,)), 1)
    centres, variance = np.linspace(-1.0, 1.0, 5), 0.5**2 / (8.0 * math.log(2.0))
    for x in np.linspace(-2.0, 2.0, 81):
        expected = np.exp(-((x - centres) ** 2) / (2.0 * variance))
        expected[0] = 1.0 if x < -1.0 else expected[0]
        expected[-1] = 1.0 if x > 1.0 else expected[-1]
        assert np.abs(net.hidden([x])[0] - expected).max() < 1e-14, f"at {x}"
    phi, _ = net.hidden([-0.75])
    assert abs(phi[0] - 0.5) < 1e-15 and abs(phi[1] - 0.5) < 1e-15, f"neighbours cross at {phi[:2]}"


def test_of_25_nodes_on_a_grid_9_are_full_gaussians() -> None:
    net = rbf_net(Grid((-1.0, -1.0), (1.0, 1.0), (5, 5)), 1)
    far = [net.hidden(x)[0] for x in ((9.0, 0.0), (-9.0, 0.0), (0.0, 9.0), (0.0, -9.0))]
    full = np.max(far, axis=0) < 1e-9  # a one-sided node stays 1 on its side
    one_sided = np.max([net.hidden(x)[0] for x in ((9, 9), (9, -9), (-9, 9), (-9, -9))], axis=0)
    assert np.count_nonzero(~full | (one_sided > 0.5)) <= 16 and np.count_nonzero(full) >= 9
    assert np.count_nonzero(one_sided == 1.0) == 4, "the corners are one-sided on both axes"


def test_scattered_gaussians_use_the_whole_matrix_of_variances() -> None:
    draw = np.random.default_rng(8)
    centres, roots = draw.normal(size=(4, 2)), draw.normal(size=(4, 2, 2))
    precisions = np.array([np.linalg.inv(r @ r.T + 0.3 * np.eye(2)) for r in roots])
    phi = np.zeros(4)
    for x in POINTS[:10]:
        rbf.scattered(x, centres, precisions, phi)
        d = x - centres
        expected = np.exp(-0.5 * np.einsum("ji,jik,jk->j", d, precisions, d))
        assert np.abs(phi - expected).max() < 1e-14, f"at {x}"


def test_every_random_ridge_passes_through_the_region() -> None:
    v = rvfl.first_layer(3, (-1.0, 2.0), (1.0, 5.0), 200)
    corners = np.array([(1.0, a, b) for a in (-1.0, 1.0) for b in (2.0, 5.0)])
    sides = corners @ v
    assert np.all((sides.min(axis=0) < 0.0) & (sides.max(axis=0) > 0.0))


def test_fuzzy_basis_functions_are_normalised_products() -> None:
    net = made("fuzzy")
    a, b = net.weights()[1].reshape(2, -1)
    for x in POINTS:
        member = np.exp(-(a**2) * (np.repeat(x, GRID.counts) - b) ** 2)
        mu = np.outer(member[:5], member[5:]).ravel()
        assert np.abs(net.hidden(x)[0] - mu / mu.sum()).max() < 1e-14, f"at {x}"


def test_far_from_all_centres_a_fuzzy_system_still_answers_with_the_nearest_rule() -> None:
    phi, jac = made("fuzzy").hidden(np.array((300.0, -300.0)))
    assert np.isfinite(phi).all() and np.isfinite(jac).all()
    assert phi.argmax() == 24 and abs(phi.sum() - 1.0) < 1e-15, f"rule {phi.argmax()}, {phi.sum()}"


def test_the_slopes_of_a_law_are_the_jacobian_of_the_object() -> None:
    net, error = made("fuzzy"), np.array((0.7, -0.2, 1.1))
    (w, v), sets = net.weights(), 11
    a, b = v[:sets].copy(), v[sets:].copy()
    rules = fuzzy.full_grid(GRID.counts)
    da, db, c = np.zeros(sets), np.zeros(sets), w @ error
    for x in POINTS[:10]:
        phi, jac = net.hidden(x)
        fuzzy.slopes(x, rules, a, b, phi, c, float(phi @ c), da, db)
        difference = np.abs(np.concatenate((da, db)) - jac.T @ c).max()
        assert difference < 1e-13, f"{difference:.1e}"


def test_a_fuzzy_set_is_never_tuned_flat() -> None:
    net = made("fuzzy")
    _, v = net.weights()
    start = v[:11].copy()
    net.step(0.0, np.concatenate((-start, np.zeros(11))))
    assert np.all(v[:11] >= start.min() / Fuzzy.RANGE * (1.0 - 1e-15)), f"{v[:11]}"
    net.step(0.0, np.concatenate((np.full(11, -1e9), np.zeros(11))))
    assert np.abs(v[:11]).max() <= start.max() * Fuzzy.RANGE and v[:11].max() < 0.0


def test_only_the_first_jump_node_jumps_and_it_is_right_continuous() -> None:
    for kind in range(3):
        phi = np.full((4, 4), 7.0)
        for row, z in zip(phi, (-1e-12, -0.0, 0.0, 1e-12), strict=True):
            jumps.jump_nodes(kind, z, 4, row, 0)
        assert phi[:, 0].tolist() == [0.0, 1.0, 1.0, 1.0], jumps.NAMES[kind]
        assert np.abs(phi[:, 1:]).max() < 1.1e-12, jumps.NAMES[kind]


def test_jump_nodes_are_their_closed_forms() -> None:
    phi = np.zeros(5)
    for kind, form in enumerate((lambda z: z, lambda z: -np.expm1(-z), np.tanh)):
        for z in (1e-9, 1e-3, 0.3, 2.0, 11.0):
            jumps.jump_nodes(kind, z, 5, phi, 0)
            error = np.abs(phi / form(z) ** np.arange(5) - 1.0).max()
            assert error < 3e-15, f"{jumps.NAMES[kind]} at {z}: relative error {error:.1e}"
        jumps.jump_nodes(kind, -2.0, 5, phi, 0)
        assert not phi.any(), jumps.NAMES[kind]


def test_polynomial_coefficients_convert_to_the_sigmoid_basis_by_lemma_3_1_4() -> None:
    a = (0.7, -1.2, 0.5, 0.3)
    b = jumps.sigmoid_coefficients(a)
    assert np.abs(np.array(b) - (0.7, -1.2, -0.1, 0.4)).max() < 1e-15, f"{b}"
    z = np.array((0.02, 0.01))
    rest = [np.polyval(a[::-1], h) - np.polyval(b[::-1], -np.expm1(-h)) for h in z]
    order = math.log2(abs(rest[0] / rest[1]))
    assert 3.9 < order < 4.05, f"the remainder is of order {order:.2f}, expected N + 1 = 4"


def test_wrong_shapes_and_grids_are_refused_in_one_line() -> None:
    with pytest.raises(ValueError, match=r"input of shape \(3,\): expected \(2,\)"):
        made("rbf").eval((1.0, 2.0, 3.0))
    with pytest.raises(ValueError, match="expected low < high and 2 or more centres"):
        Grid((0.0,), (0.0,), (5,))
    with pytest.raises(ValueError, match="expected 2 or 4"):
        Cmac(GRID, 1, order=3)
    with pytest.raises(ValueError, match="expected low < high for every input"):
        rvfl.first_layer(0, (0.0,), (0.0,), 3)
