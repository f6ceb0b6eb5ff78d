"""Conditions of requirements: units, margins whose sign is the verdict, errors with their cure."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcpc.executive.rig.expressions import (
    ExpressionError,
    Rows,
    Vector,
    condition,
    value,
)
from pcpc.executive.rig.units import Unit, unit, unit_of_name

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


# ---------------------------------------------------------------------------------------- units


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("N m", "J"), ("N m/s", "W"), ("rad/s2", "rad/s^2"), ("1/s", "Hz"), ("N/m2", "Pa"),
        ("m3/(s Pa0.5)", "m3 /(s Pa0.5)"), ("kg m/s2", "N"), ("mrad", "deg"), ("", "%"),
    ],
)  # fmt: skip
def test_units_of_one_kind_are_the_same(one: str, other: str) -> None:
    assert unit(one).powers == unit(other).powers, (unit(one), unit(other))


@pytest.mark.parametrize(
    ("one", "other"),
    [("rad", ""), ("N m", "N m/rad"), ("rpm", "Hz"), ("Nm", "N m"), ("rad/s", "rad"), ("(m", "m2")],
)
def test_units_of_different_kinds_differ(one: str, other: str) -> None:
    assert unit(one).powers != unit(other).powers, (unit(one), unit(other))


def test_prefixes_are_exact() -> None:
    assert unit("mrad").factor == Fraction(1, 1000) and unit("kPa").factor == 1000
    assert unit("mm2").factor == Fraction(1, 10**6) and unit("min").factor == 60
    assert unit("m99999999s").powers == (("m99999999s", 1),), "no number of such a size"


def test_a_name_tells_its_unit() -> None:
    found = {
        name: unit_of_name(name) for name in ("error_rad", "x_rad_s", "lam_per_s", "count", "rad")
    }
    assert {k: v and v.text for k, v in found.items()} == {
        "error_rad": "rad", "x_rad_s": "rad/s", "lam_per_s": "1/s", "count": None, "rad": None,
    }  # fmt: skip


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
