"""What a layer says once: what it lacks, where its tuning drives it, what it may leave in w."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from pcpc.plants.book.hidden import Hidden
from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import (
    Cycles,
    around,
    dyads,
    fitted_weights,
    inner,
    layered,
    logistic,
    size,
)
from pcpc.plants.weights import Layer, State, Vector, norm

DRAW = np.random.default_rng(4711)
CYCLES, PERIOD_S, RATE = 40, 1e-3, 7.0


def tuned(shape: tuple[int, ...], leak: Vector | float) -> tuple[Layer, Vector]:
    """Return a layer that moves as its law says, and the gradient."""
    ideal, gradient = DRAW.normal(size=shape), DRAW.normal(size=(CYCLES, *shape))
    w = np.zeros((CYCLES + 1, *shape))
    for k in range(CYCLES):
        held = leak if isinstance(leak, float) else leak[k]
        w[k + 1] = w[k] + PERIOD_S * RATE * (gradient[k] - held * w[k])
    return State(w[:-1], np.diff(w, axis=0)).layer("S", RATE, ideal, gradient, leak), gradient


@pytest.mark.parametrize("shape", [(5,), (5, 2), (3, 4, 2)])
@pytest.mark.parametrize("each", [False, True])
def test_a_layer_moves_as_its_gradient_and_leak_have_it(shape: tuple[int, ...], each: bool) -> None:
    one, gradient = tuned(shape, DRAW.uniform(0.1, 2.0, CYCLES) if each else 0.3)
    period = np.full(CYCLES - 1, PERIOD_S)
    assert one.apart(period) < 1e-12 and one.seen(period) == pytest.approx(RATE)
    assert (one.lacks + one.w == pytest.approx(np.broadcast_to(one.ideal, one.w.shape))) is True
    assert one.norm == pytest.approx(math.sqrt(float(np.sum(one.ideal**2))))
    assert one.energy == pytest.approx(size(one.ideal - one.w) ** 2 / (2.0 * RATE))
    assert one.leaked == pytest.approx(
        [np.sum(a * b) for a, b in zip(one.lacks, one.w, strict=True)]
    )
    assert not np.allclose(one.driven, gradient)


def test_parts_of_a_layer_are_its_rows() -> None:
    one, _ = tuned((5, 2), 0.3)
    near, far = one.part("N", 2.0, slice(0, 2)), one.part("F", 3.0, slice(2, None))
    assert (near.name, near.rate, far.name, far.rate) == ("N", 2.0, "F", 3.0)
    for name in ("lacks", "moved", "driven", "w"):
        both = np.concatenate((getattr(near, name), getattr(far, name)), axis=1)
        assert np.array_equal(both, getattr(one, name)), name
    assert np.array_equal(np.concatenate((near.ideal, far.ideal)), one.ideal)
    assert norm(near.lacks, far.lacks) == pytest.approx(size(one.lacks))


def test_a_map_moves_its_weights_to_the_next_cycle() -> None:
    w = DRAW.normal(size=(6, 3))
    state = State.of_steps(w)
    assert np.allclose(state.w[:-1] + state.moved[:-1], w[1:]) and not state.moved[-1].any()
    kept = state[:, :2]
    assert kept.w.shape == kept.moved.shape == (6, 2)


def hidden_layer(jumps: int = 0) -> Hidden:
    """Return four nodes over three inputs whose V wanders off from what it was drawn as."""
    v = 2.0 * DRAW.normal(size=(3, 4)) + np.cumsum(DRAW.normal(size=(200, 3, 4)), axis=0)
    made = Hidden.of(State(v, np.zeros_like(v)), 3.0 * DRAW.normal(size=(200, 3)))
    far = DRAW.normal(size=(200, jumps))
    return replace(made, nodes=np.concatenate((made.nodes, far), axis=1))


@pytest.mark.parametrize("jumps", [0, 2])
def test_nodes_behind_those_of_v_stay_in_both(jumps: int) -> None:
    one = hidden_layer(jumps)
    assert np.array_equal(one.known[:, 5:], one.nodes[:, 5:])
    assert np.allclose(one.known[:, 1:5], logistic(one.x @ one.v.w[0]))
    assert one.known[0] == pytest.approx(one.nodes[0], rel=1e-12), "V* is V as drawn"
    flat, slope, turned = one.linear
    step, z = 1e-6, np.einsum("nij,ni->nj", one.v.w, one.x)
    assert np.allclose(slope, (logistic(z + step) - logistic(z - step)) / (2.0 * step), atol=1e-8)
    assert np.allclose(flat[:, 1:5] + slope * z, one.nodes[:, 1:5])
    assert np.allclose(turned, slope * (one.x @ one.ideal - z))
    assert np.array_equal(flat[:, 5:], one.nodes[:, 5:])


def test_what_a_hidden_layer_leaves_in_w_is_within_its_constants() -> None:
    """|W*'(s* - s - s'(z* - z)) + W~'s'z*| <= c0 + c1 |Z~|, of any W."""
    one = hidden_layer()
    _, slope, turned = one.linear
    for scale in (0.1, 1.0, 30.0):
        ideal, w = scale * DRAW.normal(size=4), scale * DRAW.normal(size=(200, 4))
        z, c0, c1 = one.constants(float(np.linalg.norm(ideal)), 0.0)
        rest = (one.known - one.nodes)[:, 1:] - turned
        left = rest @ ideal + inner(ideal - w, slope * (one.x @ one.ideal))
        lack = norm(ideal - w, one.ideal - one.v.w)
        assert (np.abs(left) <= c0 + c1 * lack).all()
        assert z == pytest.approx(math.hypot(np.linalg.norm(ideal), np.linalg.norm(one.ideal)))
        size_w, reach = float(np.linalg.norm(ideal)), float(size(one.x).max())
        far = float(size(one.x @ one.ideal).max())
        assert c0 == pytest.approx(2.0 * size_w) and c1 == pytest.approx((far + size_w * reach) / 4)
        assert one.constants(size_w, 0.7)[1] == pytest.approx(c0 + 0.7)


def test_v_is_driven_by_what_comes_back_through_its_nodes() -> None:
    one, back = hidden_layer(), DRAW.normal(size=(200, 4))
    made = one.layer("T", 2.0, back, 0.1)
    for k in (0, 7, 199):
        assert np.allclose(made.driven[k], np.outer(one.x[k], back[k]) - 0.1 * one.v.w[k])
    assert np.array_equal(dyads(one.x, back)[3], np.outer(one.x[3], back[3]))
    assert made.rate == 2.0 and np.array_equal(made.lacks, one.ideal - one.v.w)


def test_weights_are_fitted_to_a_column_as_to_a_table_of_one() -> None:
    nodes, wanted = DRAW.normal(size=(50, 4)), DRAW.normal(size=50)
    column = fitted_weights(nodes, wanted)
    assert np.array_equal(column, fitted_weights(nodes, wanted[:, None])[:, 0])
    assert column.shape == (4,)


def test_values_are_drawn_from_a_quarter_more_than_their_range() -> None:
    values = np.stack((np.linspace(-1.0, 3.0, 9), np.linspace(5.0, 5.4, 9)), axis=1)
    drawn = around(values, np.random.default_rng(0), 20_000)
    assert drawn.shape == (20_000, 2)
    assert drawn.min(axis=0) == pytest.approx([-1.5, 4.95], abs=1e-2)
    assert drawn.max(axis=0) == pytest.approx([3.5, 5.45], abs=1e-2)
    assert around(values[:, 0], np.random.default_rng(0), 7).shape == (7,)


def test_a_proof_has_what_its_layers_say() -> None:
    """Their part of V, |Z~|, the least rate, and whether all rates are positive."""
    first, second = tuned((5,), 0.3)[0], replace(tuned((3, 2), 0.3)[0], rate=-2.0, name="T")
    parts = (first.part("N", 4.0, slice(0, 2)), first.part("F", 3.0, slice(2, None)), second)
    own = Assumption("a", True, "b")
    run, zero = cast(Cycles, SimpleNamespace(t_s=np.arange(float(CYCLES)))), np.zeros(CYCLES)

    def made(rates: tuple[Layer, ...] = (), scale: float = 1.0) -> Proof:
        return layered(
            run,
            ("theorem", "error"),
            (first, second),
            v=zero + 5.0,
            damping=zero + 1.0,
            terms={"t": zero + 2.0},
            error=zero + 3.0,
            rest=zero + 4.0,
            constants=Constants(1.0, 1.0, 1.0, 1.0),
            asked=[own],
            rates=rates,
            scale=scale,
            extra=zero + 6.0,
            beyond={"u": zero},
            step_s=9.0,
        )

    whole, split, scaled = made(), made(parts), made(scale=0.5)
    assert np.allclose(whole.v, 5.0 + first.energy + second.energy)
    assert np.allclose(split.v, 5.0 + sum(one.energy for one in parts))
    assert np.allclose(scaled.v, 5.0 + 0.5 * (first.energy + second.energy))
    assert [one.constants.gamma for one in (whole, split, scaled)] == [2.0, 2.0, 4.0]
    assert np.allclose(whole.weights, np.hypot(size(first.lacks), size(second.lacks)))
    assert np.array_equal(whole.weights, split.weights)
    assert [one.name for one in split.tuned] == ["N", "F", "T"]
    assert whole.asked[1] is own and whole.asked[0].found == "T not above 0"
    assert (whole.theorem, whole.error_is, whole.step_s) == ("theorem", "error", 9.0)
    assert [float(one[0]) for one in (whole.damping, whole.error, whole.rest)] == [1.0, 3.0, 4.0]
    assert whole.extra is not None and whole.extra[0] == 6.0
    assert list(whole.terms) == ["t"] and list(whole.beyond) == ["u"] and whole.t_s[1] == 1.0


def test_without_a_rate_weights_count_as_they_are() -> None:
    one = replace(tuned((5,), 0.3)[0], rate=0.0)
    assert one.energy == pytest.approx(0.5 * size(one.lacks) ** 2)
