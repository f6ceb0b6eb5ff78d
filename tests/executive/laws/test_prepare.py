"""What `prepare` hands on: 12 digits of each number however it is given, zeros with their sign."""

import math
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcpc.executive.laws.block import Block, Nothing, Ports, Prepared, port, stage
from pcpc.executive.own_laws.preparation import prepared_values


class Gains(Ports):
    """One number and several."""

    one: float = port("", "one number", default=1.0)
    several: Any = port("", "three numbers", shape=3, default=4.0)


class Kept(Ports):
    """States that have a default, and those that begin at 0."""

    at: float = port("", "begins at -0", default=-0.0)
    cells: Any = port("", "begin at 0", shape=2)


@stage
def idle(t: float, dt: float, p: Gains, x: Kept, u: Nothing, y: Nothing) -> None:
    """Do nothing."""


def handed_on(
    parameters: dict[str, Any], states: dict[str, Any] | None = None
) -> list[list[float]]:
    block = Block(idle, prepare=lambda settings, rate_hz, seed: Prepared(parameters, states or {}))
    return [[value for _, value in values] for values in prepared_values(block, {}, 1000.0, 1)]


def bits(values: list[float]) -> list[bytes]:
    return [struct.pack("d", value) for value in values]


@given(st.lists(st.floats(allow_nan=False), min_size=4, max_size=4))
def test_numbers_are_those_of_12_digits_however_they_are_given(numbers: list[float]) -> None:
    wanted = bits([float(f"{number:.12g}") for number in numbers])
    names = ("one", "several_0", "several_1", "several_2")
    by_element = dict(zip(names, numbers, strict=True))
    for form in ({"one": numbers[0], "several": numbers[1:]}, by_element):
        assert bits(handed_on(form)[0]) == wanted, form


def test_zeros_keep_their_sign_beside_each_other() -> None:
    for zero in (0.0, -0.0, 0.0, -0.0):
        own, _ = handed_on({"one": zero, "several": [zero, -zero, zero]})
        assert bits(own) == bits([zero, zero, -zero, zero]), zero


def test_what_is_not_given_is_its_default() -> None:
    own, states = handed_on({})
    assert own == [1.0, 4.0, 4.0, 4.0]
    assert bits(states) == bits([-0.0, 0.0, 0.0])
    own, states = handed_on({"several_1": 7.0}, {"cells_1": 2.0})
    assert own == [1.0, 4.0, 7.0, 4.0]
    assert states == [-0.0, 0.0, 2.0]


def test_nan_is_refused_by_the_name_of_its_element() -> None:
    with pytest.raises(ValueError, match="several_2: prepare gave nan"):
        handed_on({"several_2": math.nan})
