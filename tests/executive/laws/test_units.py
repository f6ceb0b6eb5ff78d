"""The algebra of units: what a text names, and what product, quotient, power, derivative give."""

from fractions import Fraction
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcpc.executive.laws.table import derivative, unit_of
from pcpc.executive.laws.units import Unit, from_fmi, in_fmi, unit, unit_of_name

SYMBOLS = st.sampled_from(
    ["m", "mm", "s", "rad", "mrad", "deg", "N", "kPa", "A", "V", "J", "%", "1", "min", "us"]
)
KNOWN = st.lists(SYMBOLS, min_size=1, max_size=3).flatmap(
    lambda parts: st.sampled_from([" ".join(parts), "/".join(parts), f"{'/'.join(parts)}/s2"])
)


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
    assert unit("m10").powers == (("m", 10),) and unit("ms").factor == Fraction(1, 1000)
    for text in ("m99999999s", "Mm99 Mm99", "nm99 nm99"):
        assert unit(text).powers == ((text, 1),), "no number of such a size"


@pytest.mark.parametrize(
    "units",
    [
        ("m", "m/s", "m/s2", "m/s3"), ("", "1/s", "1/s2", "1/s3"), ("rad", "rad/s", "rad/s2"),
        ("mm", "mm/s", "mm/s2"), ("deg", "deg/s", "deg/s2"), ("%", "%/s", "%/s2"),
        ("N m", "N m/s", "N m/s2"), ("N m s/rad", "N m s/rad/s", "N m s/rad/s2"),
        ("kg/m3", "kg/m3/s", "kg/m3/s2"), ("rpm", "rpm/s", "rpm/s2"), ("1/min", "1/min/s"),
        ("degC", "degC/s", "degC/s2"), ("1", "1/s"),
        ("rad/s^2", "rad/s3"), ("kg m2/(rad s2)", "kg m2/(rad s3)"), ("m s", "m s/s"),
    ],
    ids=lambda units: units[0] or "none",
)  # fmt: skip
def test_a_derivative_is_in_the_unit_a_second(units: tuple[str, ...]) -> None:
    for text, after in pairwise(units):
        assert unit(text).per_second() == unit(after)
        if unit(after).order and text != "1" and "^" not in text:
            assert unit(after).per_second(-1).text == text
        assert unit(text).per_second(0).text == text
    last = len(units) - 1
    assert unit(units[0]).per_second(last).text == units[-1], "at once"


@settings(max_examples=200, deadline=None)
@given(KNOWN, st.integers(-2, 3))
def test_a_derivative_keeps_the_factor_and_takes_seconds_off(text: str, order: int) -> None:
    one, made = unit(text), unit(text).per_second(order)
    assert made.powers == (one / unit("s").to_the(Fraction(order))).powers
    assert made.factor == one.factor and unit(made.text) == made, "its name says the same"


@settings(max_examples=200, deadline=None)
@given(KNOWN, KNOWN)
def test_a_product_is_in_base_units_and_its_name_says_so(one: str, other: str) -> None:
    a, b = unit(one), unit(other)
    for made in (a * b, a / b, a.to_the(Fraction(1, 2))):
        assert made.factor == 1 and unit(made.text).powers == made.powers, made
    assert (a * b / b).powers == a.powers and (a * b).powers == (b * a).powers
    both = a.named_over(b)
    assert (both.factor, both.powers) == (a.factor / b.factor, (a / b).powers)


def test_a_quotient_can_have_both_names() -> None:
    assert unit("N m").named_over(unit("mrad/s")) == Unit(
        "(N m)/(mrad/s)", Fraction(1000), unit("N m s/rad").powers
    )
    assert unit("").named_over(unit("rad")).text == "(1)/(rad)"


NAMES = {
    "error_rad": "rad", "x_rad_s": "rad/s", "lam_per_s": "1/s", "kt_N_m": "N/m", "count": None,
    "rad": None, "p_Pa": "Pa", "v_mm_s": "mm/s", "w_deg_s": "deg/s", "a_mrad_s2": "mrad/s2",
    "jerk_Nm_s2": "N m/s2", "f_hz": "Hz", "t_ms": "ms", "rate_s2": None,
}  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_name_tells_its_unit_and_a_column_the_same_if_it_is_of_si(name: str) -> None:
    found = unit_of_name(name)
    assert (found and found.text) == NAMES[name]
    assert unit_of(name) == (found.text if found and found.factor == 1 else "")


@pytest.mark.parametrize(
    ("name", "text", "rate", "acc"),
    [
        ("q_d_rad", "rad", ("q_d_rate_rad_s", "rad/s"), ("q_d_acc_rad_s2", "rad/s2")),
        ("v_m_s", "m/s", ("v_rate_m_s2", "m/s2"), ("v_acc_m_s3", "m/s3")),
        ("x", "rad/s", ("x_rate", "rad/s2"), ("x_acc", "rad/s3")),
        ("v_rad_s", "mm", ("v_rate_rad_s2", "mm/s"), ("v_acc_rad_s3", "mm/s2")),
        ("q_rad_s2", "rad/s2", ("q_rate_rad_s2_s", "rad/s3"), ("q_acc_rad_s2_s2", "rad/s4")),
        ("share", "", ("share_rate", "1/s"), ("share_acc", "1/s2")),
    ],
)  # fmt: skip
def test_derivatives_of_a_column_have_its_unit_a_second(
    name: str, text: str, rate: tuple[str, str], acc: tuple[str, str]
) -> None:
    assert (derivative(name, text, 1), derivative(name, text, 2)) == (rate, acc)


def test_units_of_modelica_as_they_are_written_here() -> None:
    written = ["N.m", "kg.m2/s2", "m/s^2", "1", "rad/s", "N*m", "", "W/(m2.K)"]
    here = ["N m", "kg m2/s2", "m/s2", "", "rad/s", "N m", "", "W/(m2 K)"]
    assert [from_fmi(text) for text in written] == here
    assert [from_fmi(in_fmi(text)) for text in here] == here
