"""Ports by name: the same places and bits compiled, interpreted and in the table."""

import numpy as np
import pytest
from interpreting import interpreted
from numpy.typing import NDArray

from pcpc.drivers.compiled.stage import Stage
from pcpc.executive.laws.block import (
    Block,
    Nothing,
    Ports,
    flat,
    group,
    inline,
    port,
    required,
    stage,
)


class Inner(Ports):
    """A part."""

    a = port("m", "a vector", shape=3, recorded=False)
    b = port("s", "a number", 2.5, 0.0, 3.0)


class Base(Ports):
    """What comes first."""

    first = port("", "a number")


class States(Base):
    """All kinds of ports."""

    w = port("kg", "a matrix", shape=(2, 3))
    inner = group(Inner)
    again = group(Inner, "again_", recorded=False)
    q_rad = port("rad", "angle of joint #", (0.5, -0.5), -1.0, 1.0, shape=2, named="q_#_rad")
    last = port("", "a number")


@inline
def row_sum(row: NDArray[np.float64]) -> float:
    """Return the sum of a row that is longer or shorter."""
    total = 0.0
    for i in range(len(row)):
        total += row[i]
    return total


@stage
def step(t: float, dt: float, p: Nothing, x: States, u: Inner, y: Inner) -> None:
    """Use every kind of access."""
    x.first += t
    for n in range(len(x.w)):
        for j in range(len(x.w[n])):
            x.w[n, j] += 10.0 * n + j + u.a[j]
    x.last = row_sum(x.w[1]) + x.inner.b
    x.inner.a[2] = x.q_rad[1] * u.b
    x.again.a[int(u.b)] = -1.0
    y.b = x.inner.a[2] / dt
    all_of_them = flat(x.inner)
    y.a[0] = row_sum(all_of_them)
    y.a[1] = len(all_of_them)


SIZE = 1 + 6 + 4 + 4 + 2 + 1


def vectors() -> list[NDArray[np.float64]]:
    chance = np.random.default_rng(3)
    p, x, u, y = np.zeros(0), chance.normal(size=SIZE), chance.normal(size=4), np.zeros(4)
    u[3] = 1.25
    return [p, x, u, y]


def test_the_order_of_declaration_is_the_order_in_memory() -> None:
    assert States.size == SIZE
    names = [name for one in States.ports for name in one.names()]
    assert names == [
        "first", "w_0", "w_1", "w_2", "w_3", "w_4", "w_5", "a_0", "a_1", "a_2", "b",
        "again_a_0", "again_a_1", "again_a_2", "again_b", "q_1_rad", "q_2_rad", "last",
    ]  # fmt: skip
    told = {one.name: one for one in States.ports}
    assert [told[name].default for name in ("q_1_rad", "q_2_rad", "b")] == [0.5, -0.5, 2.5]
    assert told["q_2_rad"].help == "angle of joint 2" and told["q_2_rad"].low == -1.0
    assert [told[name].recorded for name in ("b", "a", "again_b")] == [True, False, False]


def stepped() -> list[NDArray[np.float64]]:
    """Return the vectors of a step behind it."""
    after = vectors()
    step(3.0, 0.1, *after)
    return list(after)


def hexes(arrays: list[NDArray[np.float64]]) -> list[str]:
    return [one.tobytes().hex() for one in arrays]


def test_compiled_and_interpreted_steps_are_the_views_bit_for_bit() -> None:
    assert isinstance(step, Stage)
    compiled, by_hand = stepped(), vectors()
    _, x, u, y = by_hand
    x[0] += 3.0
    for n in range(2):
        for j in range(3):
            x[1 + 3 * n + j] += 10.0 * n + j + u[j]
    x[17] = ((0.0 + x[4]) + x[5]) + x[6] + x[10]
    x[9] = x[16] * u[3]
    x[11 + 1] = -1.0
    y[3] = x[9] / 0.1
    y[0] = 0.0 + x[7] + x[8] + x[9] + x[10]
    y[1] = 4.0
    for ours, theirs in zip(compiled, by_hand, strict=True):
        assert ours.tobytes() == theirs.tobytes()
    assert compiled[0].size == 0, "it has no parameters"
    assert interpreted(__name__, "t.hexes(t.stepped())") == str(hexes(compiled))


def test_a_block_takes_its_ports_from_its_step() -> None:
    block = Block(step)
    assert block.states == States.ports and block.inputs == Inner.ports == block.outputs
    assert block.size(block.states) == SIZE and block.parameters == ()


def test_what_is_not_declared_is_refused_with_what_is() -> None:
    view = States(np.zeros(SIZE))
    with pytest.raises(AttributeError, match="States has no port frist; did you mean first"):
        view.frist = 1.0
    with pytest.raises(AttributeError, match="States has no port lats; did you mean last"):
        _ = view.lats
    for name in ("w", "inner"):
        with pytest.raises(AttributeError, match=f"{name} has several values"):
            setattr(view, name, 0.0)


def test_declarations_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="two ports are named b"):
        type("Twice", (Inner,), {"b": port("", "again")})
    with pytest.raises(ValueError, match="two ports are named a_1"):
        type("Hidden", (Inner,), {"a_1": port("", "an element's name")})
    with pytest.raises(ValueError, match="shape 0"):
        port("", "nothing", shape=0)
    with pytest.raises(ValueError, match="3 defaults for 2"):
        port("", "too many", (1.0, 2.0, 3.0), shape=2, named="x_#")


def test_vectors_that_do_not_fit_are_refused_before_the_step() -> None:
    p, x, u, y = vectors()
    for wrong in (x[:-1], x[::2], x.astype(np.float32), x.tolist()):
        with pytest.raises(TypeError, match=f"x: .* at least {SIZE} values"):
            step(0.0, 0.1, p, wrong, u, y)


def test_a_changed_layout_is_another_type() -> None:
    from pcpc.drivers.compiled.view_types import view

    class Same(Ports):
        a = port("", "", shape=3)
        b = port("", "")

    class Other(Ports):
        a = port("", "", shape=4)
        b = port("", "")

    class Inner2(Ports):
        a = port("", "", shape=3)
        c = port("", "")

    kinds = {view(d.layout).name.partition(",")[2] for d in (Inner, Same, Other, Inner2)}
    assert len(kinds) == 3, kinds


def test_in_lanes_a_value_takes_the_place_of_eight() -> None:
    from pcpc.drivers.compiled.lane_types import LANE
    from pcpc.drivers.compiled.view_types import view

    one, eight = view(States.layout), view(States.layout, LANE)
    assert (one.size, eight.size, view(Nothing.layout).size) == (8 * SIZE, 64 * SIZE, 0)
    assert one != eight and list(one.fields) == list(eight.fields)
    for (_, place), (_, wide) in zip(one.fields.values(), eight.fields.values(), strict=True):
        assert wide == 8 * place
    assert [two.fields["inner"][0].size for two in (one, eight)] == [8 * 4, 64 * 4]

    class Ending(Ports):
        inner = group(Inner)

    assert view(Ending.layout).size == 8 * 4, "of what ends with a group"


def test_required_takes_every_default_away_and_nothing_else() -> None:
    class Given(Ports):
        a = port("m", "one", 1.0, -2.0, 2.0)
        q_rad = port("rad", "two", (0.5, -0.5), shape=2, named="q_#_rad")

    bare = required(Given)
    assert [one.default for one in Given.ports] == [1.0, 0.5, -0.5]
    assert [one.default for one in bare.ports] == [None, None, None]
    assert bare.layout == Given.layout and bare.ports[0].low == -2.0
