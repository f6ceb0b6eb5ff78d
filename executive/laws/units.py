"""Units of variables and of numbers beside them: `rad/s`, `N m`, `2 mrad`, `10 %`.

    unit      parts with blanks between them multiply; a slash divides by the next part, or (group)
    part      [prefix]symbol[exponent], as mm, m2, m^2, Pa0.5

Derived units are reduced (J is N m is kg m2/s2), but not rad, which is never a plain number. A unit
that is not understood, as rpm, is one of its own, and rpm/s is that a second.

    product, quotient, power      in base units: mm times mm is m2
    derivative                    in the unit a second, whose name has /s behind it or one s more:
                                  m, m/s, m/s2; N m, N m/s; mm, mm/s, mm/s2
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

Powers = tuple[tuple[str, Fraction], ...]  # of base units, by name
_LONGEST, _LARGEST = 60, Fraction(10) ** 99  # letters, and factor, of a unit that is understood
_PREFIXES = {"": 0, "n": -9, "u": -6, "m": -3, "c": -2, "k": 3, "M": 6}
_SYMBOLS: Mapping[str, tuple[Fraction | float, str]] = {  # factor, and what it is in base units
    "m": (1, ""), "s": (1, ""), "rad": (1, ""), "A": (1, ""), "K": (1, ""), "ue": (1, ""),
    "degC": (1, ""), "g": (Fraction(1, 1000), "kg"), "N": (1, "kg m/s2"), "J": (1, "kg m2/s2"),
    "W": (1, "kg m2/s3"), "Pa": (1, "kg/(m s2)"), "V": (1, "kg m2/(A s3)"), "Hz": (1, "1/s"),
    "min": (60, "s"), "deg": (math.pi / 180.0, "rad"), "%": (Fraction(1, 100), "1"), "1": (1, "1"),
}  # fmt: skip
_PART = (
    rf"(?P<prefix>(?:[{''.join(_PREFIXES)}](?!1))?)"
    rf"(?P<symbol>{'|'.join(sorted(_SYMBOLS, reverse=True))})"
    r"(?P<power>\^?-?\d{1,2}(?:\.\d+)?)?(?![\w.^:])"
)
_TOKEN = re.compile(rf"\s*(?:(?P<sign>[/()])|{_PART})")
_SECONDS = re.compile(r"(.+?)\s*/\s*s(?:\^?([1-9]))?")
_NAMELESS = r"(?!\d)" + re.sub(r"\?P<\w+>", "?:", _PART)
AFTER_NUMBER = rf"\s*{_NAMELESS}(?:(?:\s+|\s*/\s*){_NAMELESS})*"  # the unit of a number, a pattern


@dataclass(frozen=True)
class Unit:
    """A value in it, times `factor`, is in base units; `powers` of those, by name."""

    text: str
    factor: Fraction
    powers: Powers

    def __mul__(self, other: "Unit") -> "Unit":
        return _base(_product(self.powers, other.powers))

    def __truediv__(self, other: "Unit") -> "Unit":
        return self * other.to_the(Fraction(-1))

    @property
    def order(self) -> int:
        """The power of the seconds that its name divides by last: 2 of m/s2, 0 of N m."""
        return _base_and_order(self.text)[1]

    def per_second(self, order: int = 1) -> "Unit":
        """Return the unit of its derivative of this order; of a negative one, of its integral."""
        if not order:
            return self
        powers = _product(self.powers, (("s", Fraction(-order)),))
        if self.text.endswith(")") and self == _base(self.powers):
            return _base(powers)
        base, own = _base_and_order(self.text)
        base, n = ("" if base == "1" else base), own + order
        named = _power("s", Fraction(abs(n)))
        text = f"{base or '1'}/{named}" if n > 0 else f"{base} {named}".strip() if n < 0 else base
        return Unit(text, self.factor, powers)

    def named_over(self, other: "Unit") -> "Unit":
        """Return a quotient under the name that has both: (N m)/(rad/s)."""
        text = f"({self.text or '1'})/({other.text or '1'})"
        return Unit(text, self.factor / other.factor, (self / other).powers)

    def to_the(self, power: Fraction) -> "Unit":
        """Return a power of it, in base units."""
        return _base(tuple((name, power * n) for name, n in self.powers))


@lru_cache(maxsize=1024)
def unit(text: str) -> Unit:
    """Return the unit that a text names."""
    try:
        factor, powers, rest = _parsed_unit(text.strip()[:_LONGEST])
    except ValueError:
        factor, powers, rest = Fraction(1), (), text
    if not rest and len(text) <= _LONGEST and 1 / _LARGEST < factor < _LARGEST:
        return Unit(text, factor, powers)
    base, order = _base_and_order(text)
    return Unit(text, Fraction(1), _product(((base, Fraction(1)),), (("s", Fraction(-order)),)))


def _base_and_order(text: str) -> tuple[str, int]:
    """Return a name without the seconds that it divides by last, and their power: m, 2 of m/s2."""
    found = _SECONDS.fullmatch(text)
    return (found[1], int(found[2] or 1)) if found else (text, 0)


def _parsed_unit(text: str) -> tuple[Fraction, Powers, str]:
    """Return factor, powers, and what stands behind a closing bracket; ValueError."""
    factor, way = Fraction(1), Fraction(1)
    powers: Powers = ()
    while text:
        token = _TOKEN.match(text)
        if token is None:
            raise ValueError(text)
        text = text[token.end() :]
        if token["sign"] == ")":
            break
        if token["sign"] == "/":
            way = Fraction(-1)
            continue
        if token["sign"] == "(":
            part_factor, part, text = _parsed_unit(text)
        else:
            part_factor, part = _part(token["prefix"], token["symbol"])
            way *= Fraction((token["power"] or "1").lstrip("^"))
        factor *= (
            part_factor ** int(way)
            if way.denominator == 1
            else Fraction(float(part_factor) ** float(way))
        )
        powers = _product(powers, tuple((name, way * n) for name, n in part))
        way = Fraction(1)
    return factor, powers, text


def _part(prefix: str, symbol: str) -> tuple[Fraction, Powers]:
    """Return a symbol with its prefix in base units."""
    scale, stands_for = _SYMBOLS[symbol]
    factor = Fraction(scale) * Fraction(10) ** _PREFIXES[prefix]
    if symbol == "g":
        return factor, (("kg", Fraction(1)),)
    if not stands_for:
        return factor, ((symbol, Fraction(1)),)
    return factor, () if stands_for == "1" else unit(stands_for).powers


def _product(a: Powers, b: Powers) -> Powers:
    powers = dict(a)
    for name, n in b:
        powers[name] = powers.get(name, Fraction(0)) + n
    return tuple(sorted((name, n) for name, n in powers.items() if n))


def _base(powers: Powers) -> Unit:
    """Return a unit of base units, with the text that names it."""
    numerator = " ".join(_power(name, n) for name, n in powers if n > 0)
    under = [_power(name, -n) for name, n in powers if n < 0]
    below = under[0] if len(under) == 1 else f"({' '.join(under)})"
    return Unit(f"{numerator or '1'}/{below}" if under else numerator, Fraction(1), powers)


def _power(name: str, n: Fraction) -> str:
    return name if n == 1 else f"{name}{float(n):g}"


def unit_of_name(name: str) -> Unit | None:
    """Return the unit that a name ends in, as error_rad, rate_rad_s, torque_Nm; None for none."""
    parts = name.split("_")
    for i in range(max(len(parts) - 3, 1), len(parts)):
        if (ending := "_".join(parts[i:])) in _ENDINGS:
            return unit(_ENDINGS[ending])
    return None


def from_fmi(text: str) -> str:
    """Return a unit of FMI as pcpc writes it: N.m as N m, m/s^2 as m/s2, 1 as none."""
    text = re.sub(r"\s*[.*](?=[A-Za-z(])\s*", " ", text.strip()).replace("^", "")
    return "" if text in ("1", "-") else text


def in_fmi(text: str) -> str:
    """Return a unit as FMI writes it: N m as N.m."""
    return text.replace(" ", ".")


_SAME = ("rad", "mrad", "deg", "m", "mm", "N", "Pa", "V", "A")
_QUANTITIES = {"Nm": "N m", **{name: name for name in _SAME}}
_ENDINGS = {  # of names
    **_QUANTITIES,
    **{f"{end}_s": unit(text).per_second().text for end, text in _QUANTITIES.items()},
    **{f"{end}_s2": unit(text).per_second(2).text for end, text in _QUANTITIES.items()},
    **{name: name for name in ("s", "ms", "us", "Hz")},
    "hz": "Hz", "per_s": "1/s", "N_m": "N/m",
}  # fmt: skip


NONE = unit("")  # of a plain number
