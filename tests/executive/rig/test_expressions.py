"""Conditions of requirements: units, margins whose sign is the verdict, errors with their cure."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcpc.executive.laws.units import Unit, unit
from pcpc.executive.rig import expressions as ex
from pcpc.executive.rig.expressions import (
    ExpressionError,
    Rows,
    Vector,
    condition,
    value,
)

UNITS = {
    "a.e_rad": "rad", "a.rate_rad_s": "rad/s", "a.tau_Nm": "N m", "a.late_us": "us", "a.n": "",
    "plant:m.x_mm": "mm", "a.speed": "rpm", "a.k": "N m s/rad", "a.p_Pa": "Pa",
}  # fmt: skip
NUMBERS = st.sampled_from((-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, math.inf, -math.inf, math.nan))


def units(name: str) -> Unit | None:
    if name not in UNITS:
        raise ExpressionError(f"no variable {name}")
    return unit(UNITS[name])


def rows(cycles: list[int] | None = None, **columns: list[float]) -> Rows:
    """Return rows; keywords a_e_rad stand for a.e_rad."""
    named = {name.replace("_", ".", 1): np.array(own) for name, own in columns.items()}
    count = len(next(iter(named.values())))
    return Rows(np.array(cycles or range(count)), named, 1e-3)


def margins(text: str, given: Rows) -> Vector:
    return condition(text, units).margin(given)


# -------------------------------------------------------------------------------------- margins


@pytest.mark.parametrize(
    ("text", "e", "margin"),
    [
        ("a.e_rad < 2 mrad", 0.0005, 0.0015), ("a.e_rad < 2e-3", 0.0005, 0.0015),
        ("abs(a.e_rad) <= 1 deg", -1.0, math.pi / 180 - 1.0), ("a.e_rad == 2", 2.0, 0.0),
        ("a.e_rad == 2", 1.5, -0.5), ("a.e_rad != 2", 1.5, 0.5), ("-1 < a.e_rad < 3", 2.5, 0.5),
        ("a.e_rad > 1 or a.e_rad < 0", 0.25, -0.25), ("not a.e_rad > 1", 0.25, 0.75),
        ("min(a.e_rad, 1) < 2 and max(a.e_rad, 5) < 7", 3.0, 1.0), ("2 * a.e_rad < 5", 2.0, 1.0),
        ("a.e_rad / 2 < 5", 2.0, 4.0), ("sqrt(a.e_rad * a.e_rad) < 3 rad", -2.0, 1.0),
        ("a.e_rad + 1 mrad < 2 rad - 1 mrad", 1.0, 0.998), ("2 * 3 > a.e_rad", 2.0, 4.0),
        ("1 / a.e_rad < 1 - -1", 1.0, 1.0), ("a.e_rad<.5e1rad", 1.0, 4.0),
    ],
)  # fmt: skip
def test_the_margin_of_a_condition(text: str, e: float, margin: float) -> None:
    (found,) = margins(text, rows(a_e_rad=[e]))
    assert found == pytest.approx(margin, abs=1e-12), text


def test_a_bare_number_has_the_unit_of_its_neighbour() -> None:
    late = rows(a_late_us=[400.0])
    for text in ("a.late_us < 500", "a.late_us < 500 us", "a.late_us < 0.5 ms"):
        assert margins(text, late)[0] == pytest.approx(1e-4), text
    said = condition("a.late_us < 0.5 ms", units).said(late, 0)
    assert (said.value, said.limit, said.unit.text) == (
        pytest.approx(400),
        pytest.approx(500),
        "us",
    )


def test_what_decided_is_told_with_the_value_before_its_limit() -> None:
    given = rows(a_e_rad=[1.0], a_n=[4.0])
    for text, what, limit in (
        ("2 > a.e_rad and a.n < 4.5", "a.n", 4.5), ("2 > a.e_rad or a.n < 4.5", "a.e_rad", 2.0),
        ("not (a.e_rad < 3 or a.n >= 9)", "a.e_rad", 3.0),
    ):  # fmt: skip
        said = condition(text, units).said(given, 0)
        assert (said.what, said.limit) == (what, limit), text


def test_products_have_the_unit_of_both() -> None:
    assert margins("a.k * a.rate_rad_s < 3 N m", rows(a_k=[1.0], a_rate_rad_s=[2.0]))[0] == 1.0
    assert (
        margins("a.tau_Nm * a.rate_rad_s < 3 N m rad/s", rows(a_tau_Nm=[1.0], a_rate_rad_s=[2.0]))[
            0
        ]
        == 1.0
    )


def test_a_rate_is_the_change_a_second_between_recorded_cycles() -> None:
    given = rows([3, 4, 8], a_e_rad=[1.0, 1.5, 0.5])
    found = value("rate(a.e_rad)", units)
    assert found.at(given) == pytest.approx([0.0, 500.0, -250.0])
    assert found.unit == unit("rad/s")


@pytest.mark.parametrize(
    ("text", "of", "value_of", "shown"),
    [
        ("rate(a.x) < 5", "mm", 1.0, "mm/s"), ("rate(a.x) < 5", "mm/s", 1.0, "mm/s2"),
        ("rate(a.x) < 5 m/s2", "mm/s", 1.0, "mm/s2"), ("rate(a.x) < 5", "deg/s", 1.0, "deg/s2"),
        ("rate(rate(a.x)) < 5", "mm", 1000.0, "mm/s2"), ("rate(a.x) < 5", "kN/m", 1.0, "kN/m/s"),
        ("abs(rate(2 * a.x)) < 5", "mm/s", 2.0, "mm/s2"), ("rate(a.x) < 5", "%/s", 1.0, "%/s2"),
        ("rate(a.x) < 5", "N m/s", 1.0, "N m/s2"), ("rate(a.x) < 5", "rpm/s", 1.0, "rpm/s2"),
        ("5 > rate(a.x * a.x)", "m/s", 1.0, "m2/s3"), ("rate(a.x) < 5", "1/min", 1.0, "1/min/s"),
    ],
)  # fmt: skip
def test_a_bare_number_beside_a_rate_is_in_the_unit_of_the_value_a_second(
    text: str, of: str, value_of: float, shown: str
) -> None:
    made = condition(text, lambda name: unit(of))
    last = made.said(Rows(np.array([0, 1000]), {"a.x": np.array([0.0, 1.0])}, 1e-3), 1)
    limit = 5000.0 if "m/s2" in text else 5.0
    if "rate(rate" not in text:
        assert last.value == pytest.approx(value_of)
    assert (last.limit, last.unit.text) == (pytest.approx(limit), shown)


def test_a_unit_of_its_own_a_second_is_that_of_its_rate() -> None:
    both = {"a.x": unit("rpm"), "a.y": unit("rpm/s")}
    assert condition("rate(a.x) < 2 * a.y", both.__getitem__).unit == unit("rpm/s")
    with pytest.raises(ExpressionError, match=r"'rpm/s', a.x is in 'rpm'"):
        condition("rate(a.x) < a.x", both.__getitem__)


TEXTS = st.sampled_from(
    [
        "a.e_rad < 1",
        "a.e_rad <= a.x_rad",
        "a.e_rad > -1 rad",
        "a.x_rad >= 0",
        "a.e_rad == a.x_rad",
        "a.e_rad != 1",
        "-1 <= a.x_rad < 1",
    ]
)
FORMULAS = st.recursive(
    TEXTS,
    lambda inner: st.one_of(
        inner.map(lambda a: f"not ({a})"),
        st.tuples(inner, st.sampled_from(["and", "or"]), inner).map(
            lambda t: f"({t[0]}) {t[1]} ({t[2]})"
        ),
    ),
    max_leaves=5,
)


@settings(max_examples=300, deadline=None)
@given(FORMULAS, st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=5))
def test_the_sign_of_the_margin_is_what_python_says(
    text: str, pairs: list[tuple[float, float]]
) -> None:
    made = condition(text, lambda name: unit("rad"))
    found = made.margin(rows(a_e_rad=[e for e, _ in pairs], a_x_rad=[x for _, x in pairs]))
    plain = text.replace("a.e_rad", "e").replace("a.x_rad", "x").replace(" rad", "")
    for (e, x), margin in zip(pairs, found, strict=True):
        if not (math.isnan(e) or math.isnan(x)):
            assert (margin >= 0.0) == eval(plain, {"e": e, "x": x}), (plain, e, x, margin)


def test_what_is_not_a_number_holds_nowhere() -> None:
    given = rows(a_e_rad=[math.nan])
    for text in ("a.e_rad < 1", "not a.e_rad < 1", "a.e_rad != 1", "not (a.e_rad == 1)"):
        assert margins(text, given)[0] == -math.inf, text


@settings(max_examples=100, deadline=None)
@given(FORMULAS, st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=5))
def test_an_expression_is_data_whose_inverse_of_the_inverse_it_is(
    text: str, pairs: list[tuple[float, float]]
) -> None:
    whole = condition(text, lambda name: unit("rad"))
    assert whole.inverse().inverse() == whole == eval(repr(whole), {**vars(ex), "Unit": Unit})
    given = rows(a_e_rad=[e for e, _ in pairs], a_x_rad=[x for _, x in pairs])
    both = np.minimum(whole.margin(given), whole.inverse().margin(given))
    assert (both < 0.0).all(), "a condition and its inverse never hold both"


@pytest.mark.parametrize(
    ("text", "op", "number"),
    [
        ("2 - 3 mrad", "number", Fraction(-1, 1000)), ("2 / 4 s", "number", Fraction(1, 2)),
        ("min(2, 3 m, 1 mm)", "number", Fraction(1, 1000)), ("abs(-1)", "absolute", None),
        ("-a.n", "multiply", None), ("a.n + 2 * 3", "add", None),
    ],
)  # fmt: skip
def test_what_two_constants_give_is_a_constant(text: str, op: str, number: Fraction | None) -> None:
    made = value(text, units)
    assert (made.op, made.number) == (op, number)


# --------------------------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a.e_rad < 1 N m", "a.e_rad is in 'rad', 1 N m is in 'N m'; take values of the same unit"),
        ("a.e_rad + a.n < 1", "a.n is in '1'"), ("a.e_rad", "expected a condition"),
        ("a.speed < 3 Hz", "'rpm'"), ("a.x_rad < 1", "no variable a.x_rad"),
        ("a.e_rad <", "is not an expression"), ("a.e_rad < 1 <", "is not an expression"),
        ("(a.e_rad < 1) + 1 < 3", "calculates with the condition"), ("not a.e_rad", "needs a"),
        ("sin(a.e_rad) < 1", "calls an unknown function"), ("abs(a.n, a.n) < 1", "calls"),
        ("a.n ** 2 < 1", "is more than"), ("a.n[0] < 1", "is more than"), ("'5' < 1", "more than"),
        ("a.n in a.n", "no variable in"), ("a.n % 2 < 1", "more than"), ("a.n < 1/0", "by 0"),
        ("a.n < 1e999", "beyond the range"), ("a.n < 12 12", "is no"), ("min(a.n) < 1", "calls"),
        ("rate(a.e_rad) < 1 rad", "'rad/s'"), ("{a.n} < 1", "more"), ("[a.n] < 1", "is more"),
        ("-" * 290 + "a.n < 1", ""), ("(" * 250 + "a.n", "is not an expression"), ("", "'' is no"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_a_line_with_its_cure(text: str, said: str) -> None:
    if not said:  # deep, and right
        assert margins(text, rows(a_n=[0.5]))[0] == 0.5
        return
    with pytest.raises(ExpressionError) as caught:
        condition(text, units)
    assert said in str(caught.value) and "\n" not in str(caught.value), str(caught.value)
