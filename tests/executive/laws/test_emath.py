"""Elementary functions: error in ulp, special values, identities, and equal bits in both modes.

Run as a script it prints the digest of its points in the mode that NUMBA_DISABLE_JIT selects.
"""

import ctypes
import hashlib
import math
import os
import platform
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numba.core.errors import TypingError
from numba.core.registry import CPUDispatcher

from pcpc.drivers.compiled.jit import JIT_OFF, compiled
from pcpc.executive.laws import emath
from pcpc.executive.laws.emath_selftest import selftest

PROJECT = Path(__file__).resolve().parents[3]
INF, NAN = math.inf, math.nan
SPECIAL = [0.0, -0.0, 5e-324, -5e-324, 2.2e-308, -1e-310, 1e-17, 0.55, -0.55, 0.5, 1.5, -2.5]
SPECIAL += [22.0, -22.5, 27.5, 709.782712893384, 709.7827128933841, 710.5, -745.13, -745.14, -800.0]
SPECIAL += [emath.ANGLE_MAX, 2.0**20, -(2.0**21), 2.0**51 + 0.5, -(2.0**52) - 1.0, 1e300, -1e300]
SPECIAL += [sys.float_info.max, -sys.float_info.max, INF, -INF, NAN]


@compiled()
def sqrt_in_a_loop(x: float) -> float:
    return emath.sqrt(x)


@compiled()
def pow2_in_a_loop(k: float) -> float:
    return emath.pow2(k)


FUNCTIONS: dict[str, Callable[[float], float]] = {
    name: getattr(emath, name)
    for name in ("exp", "expmsq", "tanh", "logistic", "sin", "cos", "floor", "sign")
} | {"sqrt": sqrt_in_a_loop, "pow2": pow2_in_a_loop}


def spread(low: float, high: float, count: int = 1000) -> list[float]:
    return [float(x) for x in np.random.default_rng(1).uniform(low, high, count)]


def worst_ulp(name: str, exact: Callable[[Any], Any], points: list[float]) -> tuple[float, float]:
    """Return the largest error in units of the exact value's last place, and where."""
    function, worst = FUNCTIONS[name], (0.0, NAN)
    with mpmath.workprec(200):
        for x in points:
            reference = exact(mpmath.mpf(x))
            place = float(np.spacing(abs(float(reference))))
            error = float(abs(mpmath.mpf(float(function(x))) - reference) / mpmath.mpf(place))
            worst = max(worst, (error, x))
    return worst


@pytest.mark.parametrize(
    ("name", "exact", "low", "high", "limit"),
    [
        ("exp", mpmath.exp, -3.0, 3.0, 0.9),
        ("exp", mpmath.exp, -708.0, 709.782712893384, 0.9),
        ("exp", mpmath.exp, -745.0, -708.0, 0.9),
        ("expmsq", lambda x: mpmath.exp(-x * x), -6.0, 6.0, 1.0),
        ("expmsq", lambda x: mpmath.exp(-x * x), -27.2, 27.2, 1.0),
        ("tanh", mpmath.tanh, -0.56, 0.56, 1.3),
        ("tanh", mpmath.tanh, -22.0, 22.0, 1.3),
        ("logistic", lambda x: 1 / (1 + mpmath.exp(-x)), -8.0, 8.0, 2.5),
        ("logistic", lambda x: 1 / (1 + mpmath.exp(-x)), -745.0, 40.0, 2.5),
        ("sin", mpmath.sin, -7.0, 7.0, 0.9),
        ("sin", mpmath.sin, -emath.ANGLE_MAX, emath.ANGLE_MAX, 0.9),
        ("cos", mpmath.cos, -7.0, 7.0, 0.9),
        ("cos", mpmath.cos, -emath.ANGLE_MAX, emath.ANGLE_MAX, 0.9),
        ("sqrt", mpmath.sqrt, 0.0, 1e6, 0.501),
    ],
)
def test_error_stays_below_the_stated_ulp(
    name: str, exact: Callable[[Any], Any], low: float, high: float, limit: float
) -> None:
    error, at = worst_ulp(name, exact, spread(low, high))
    assert error <= limit, f"{name}: {error:.3f} ulp at {at!r}, stated {limit}"


@pytest.mark.parametrize(("name", "exact"), [("sin", mpmath.sin), ("cos", mpmath.cos)])
def test_zeros_of_sine_and_cosine_are_accurate(name: str, exact: Callable[[Any], Any]) -> None:
    multiples = [1, 2, 3, 4, 5, *np.random.default_rng(2).integers(6, 2**20, 500).tolist()]
    with mpmath.workprec(200):
        points = [float(k * mpmath.pi / 2) for k in multiples]
    error, at = worst_ulp(name, exact, [float(np.nextafter(x, 0.0)) for x in points] + points)
    assert error <= 0.9, f"{name}: {error:.3f} ulp at {at!r}"


@pytest.mark.parametrize(
    ("name", "x", "expected"),
    [
        ("exp", 0.0, 1.0), ("exp", -INF, 0.0), ("exp", INF, INF), ("exp", -745.14, 0.0),
        ("exp", 709.7827128933841, INF),
        ("exp", -745.13, 5e-324), ("exp", sys.float_info.max, INF), ("exp", NAN, NAN),
        ("expmsq", 0.0, 1.0), ("expmsq", INF, 0.0), ("expmsq", -1e300, 0.0), ("expmsq", NAN, NAN),
        ("tanh", -0.0, -0.0), ("tanh", 5e-324, 5e-324), ("tanh", -1e-310, -1e-310),
        ("tanh", 1e-9, 1e-9), ("tanh", INF, 1.0), ("tanh", -INF, -1.0), ("tanh", NAN, NAN),
        ("logistic", 0.0, 0.5), ("logistic", INF, 1.0), ("logistic", -INF, 0.0),
        ("logistic", -745.13, 5e-324), ("logistic", -1e300, 0.0), ("logistic", NAN, NAN),
        ("sin", -0.0, -0.0), ("sin", 5e-324, 5e-324), ("sin", 1647100.0, NAN), ("sin", INF, NAN),
        ("cos", -0.0, 1.0), ("cos", 1e-9, 1.0), ("cos", -1647100.0, NAN), ("cos", NAN, NAN),
        ("sqrt", 4.0, 2.0), ("sqrt", -0.0, -0.0), ("sqrt", INF, INF), ("sqrt", -1.0, NAN),
        ("floor", -0.5, -1.0), ("floor", -3.0, -3.0), ("floor", -INF, -INF), ("floor", NAN, NAN),
        ("sign", -5e-324, -1.0), ("sign", 0.0, 0.0), ("sign", INF, 1.0), ("sign", NAN, NAN),
        ("pow2", -1022.0, sys.float_info.min), ("pow2", 1023.0, 2.0**1023), ("pow2", 0.0, 1.0),
    ],
)  # fmt: skip
def test_special_values(name: str, x: float, expected: float) -> None:
    value = float(FUNCTIONS[name](x))
    assert bits(value) == bits(expected), f"{name}({x}) = {value}, expected {expected}"


def bits(x: float) -> bytes:
    """Return the eight bytes of x; those of one NaN for all NaN."""
    return struct.pack("<d", x if x == x else NAN)


def digest(number: Callable[[float], float]) -> str:
    """Return a hash over all functions at special and spread points, given as `number` type."""
    points = SPECIAL + spread(-1.0, 1.0) + spread(-30.0, 30.0) + spread(-750.0, 720.0)
    points += spread(-1e6, 1e6)
    whole = [float(k) for k in range(-1022, 1024)]
    total = hashlib.sha256()
    for name, function in FUNCTIONS.items():
        for x in whole if name == "pow2" else points:
            total.update(bits(float(function(number(x)))))
    for x in points:
        total.update(bits(float(emath.clip(number(x), number(-0.3), number(0.7)))))
    return total.hexdigest()


def run(arguments: list[str], folder: Path = PROJECT, **environment: str) -> tuple[int, str, str]:
    """Run Python in `folder`; return exit code, output, errors."""
    environ = os.environ | {"PYTHONPATH": str(folder)} | environment
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environ, capture_output=True, text=True
    )
    return done.returncode, done.stdout, done.stderr


def test_compiled_and_interpreted_functions_give_the_same_bits() -> None:
    here = digest(float)
    code, out, err = run([__file__], NUMBA_DISABLE_JIT="0" if JIT_OFF else "1")
    assert code == 0, err
    assert out.split() == [here, here], f"this mode {here}, other mode {out}"


def test_python_and_numpy_numbers_give_the_same_bits() -> None:
    with np.errstate(over="ignore"):
        assert digest(np.float64) == digest(float)


@given(st.floats(-22.0, 22.0))
def test_tanh_and_sine_are_odd_and_cosine_and_expmsq_even(x: float) -> None:
    assert (emath.tanh(-x), emath.sin(-x)) == (-emath.tanh(x), -emath.sin(x)), f"at {x!r}"
    assert (emath.cos(-x), emath.expmsq(-x)) == (emath.cos(x), emath.expmsq(x)), f"at {x!r}"


@given(st.floats(-1.6e6, 1.6e6))
def test_sine_and_cosine_lie_on_the_unit_circle_and_double(x: float) -> None:
    s, c = emath.sincos(x)
    assert (s, c) == (emath.sin(x), emath.cos(x)), f"at {x!r}"
    assert abs(s * s + c * c - 1.0) <= 1e-15, f"{s * s + c * c - 1.0:.1e} at {x!r}"
    s2, c2 = emath.sincos(0.5 * x)
    assert abs(s - 2.0 * s2 * c2) <= 1e-15, f"sin 2a - 2 sin a cos a = {s - 2 * s2 * c2:.1e} at {x}"
    assert abs(c - (c2 - s2) * (c2 + s2)) <= 1e-15, f"cos 2a differs at {x!r}"


@given(st.floats(-300.0, 300.0), st.floats(-300.0, 300.0))
def test_exponentials_multiply(x: float, y: float) -> None:
    error = emath.exp(x) * emath.exp(y) / emath.exp(x + y) - 1.0
    rounding = 4e-16 + math.ulp(x + y)
    assert abs(error) <= rounding, f"{error:.1e} at {x!r}, {y!r}"


@given(st.floats(-30.0, 30.0))
def test_logistic_is_a_shifted_tanh(x: float) -> None:
    error = emath.logistic(2.0 * x) - (0.5 + 0.5 * emath.tanh(x))
    assert abs(error) <= 3e-16, f"{error:.1e} at {x!r}"


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_floor_is_that_of_integers(x: float) -> None:
    assert emath.floor(x) == float(math.floor(x)), f"floor({x!r}) = {emath.floor(x)!r}"


@given(st.floats(), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
@example(-0.0, 0.0, 0.0)
@example(0.0, -0.0, 0.0)
@example(-1.0, 0.0, -0.0)
def test_clip_stays_within_its_limits_and_keeps_nan(x: float, low: float, high: float) -> None:
    value = emath.clip(x, low, high)
    expected = low if x < low else high if x > high else x
    expected = low if low > high and x == x else expected
    assert bits(value) == bits(expected), f"clip({x!r}, {low!r}, {high!r}) = {value!r}"


def always_compiled(function: Callable[[float], float]) -> Any:
    """Compile for a float64 even where NUMBA_DISABLE_JIT=1."""
    dispatcher = CPUDispatcher(function, targetoptions={"nopython": True})
    dispatcher.compile("f8(f8)")
    return dispatcher


def test_where_takes_no_integer_when_compiled() -> None:
    with pytest.raises(TypingError, match=r"write 0\.0, not 0"):
        always_compiled(lambda x: emath.where(x > 0.0, x, 0))


def test_where_compiles_to_a_select_without_a_branch() -> None:
    chosen = always_compiled(lambda x: emath.where(x > 1.0, x * x, x - 1.0))
    code = next(iter(chosen.inspect_llvm().values())).split("define")[1]
    assert "select" in code and "br i1" not in code, code


def test_selftest_passes() -> None:
    selftest()


@contextmanager
def floating_point_mode(mode: str) -> Iterator[None]:
    """Change the modes of this thread as a foreign library may: round upwards, or flush to zero."""
    libm = ctypes.CDLL("libm.so.6")
    before = (ctypes.c_uint32 * 16)()
    libm.fegetenv(before)
    changed = (ctypes.c_uint32 * 16)(*before)
    arm = platform.machine() == "aarch64"
    word = 0 if arm else 7  # FPCR, or MXCSR behind the 28 bytes of x87
    changed[word] |= {"upward": 1 << 22 if arm else 2 << 13, "flush": 1 << 24 if arm else 0x8040}[
        mode
    ]
    libm.fesetenv(changed)
    try:
        yield
    finally:
        libm.fesetenv(before)


@pytest.mark.parametrize(
    ("mode", "message"),
    [("upward", "rounding mode is not to nearest"), ("flush", "flushed to zero")],
)
def test_selftest_names_a_changed_floating_point_mode(mode: str, message: str) -> None:
    selftest()  # compiled before the mode changes
    with pytest.raises(RuntimeError, match=message), floating_point_mode(mode):
        selftest()
    selftest()


def test_selftest_names_the_function_with_a_broken_constant(tmp_path: Path) -> None:
    for package in ("drivers", "executive"):
        shutil.copytree(PROJECT / package, tmp_path / "pcpc" / package)
    (tmp_path / "pcpc" / "__init__.py").touch()
    source = tmp_path / "pcpc" / "executive" / "laws" / "emath.py"
    text = source.read_text()
    assert text.count("-0.3333333333333333 ") == 1
    source.write_text(text.replace("-0.3333333333333333 ", "-0.33333333333333326 "))
    call = "from pcpc.executive.laws.emath_selftest import selftest; selftest()"
    code, _, err = run(["-c", call], tmp_path, NUMBA_DISABLE_JIT="1")
    assert code == 1 and "in tanh: a log would not replay" in err, err


if __name__ == "__main__":
    selftest()
    with np.errstate(over="ignore"):
        print(digest(float), digest(np.float64))
