"""Elementary functions that are bit-identical everywhere: + - * /, comparison and select only.

IEEE 754 fixes the bits of these operations, compiled or interpreted; a libm does not. So stages
call these functions, never `math` or numpy.

    x = k ln2 + r                      Cody-Waite: ln2 in two parts, k times the first exact   (1)
    exp(x) = 2^k (1 + r + r^2 q(r))    |r| <= ln2/2; q of degree 10, Estrin's scheme           (2)
    x^2 = z + zl                       Dekker's exact square, for exp(-x^2)                    (3)
    tanh(x) = 1 - 2 / (1 + exp(2x))    for |x| >= 0.55; below, an odd polynomial               (4)
    logistic(x) = 1 / (1 + exp(-x))    for x >= 0; below, exp(x) / (1 + exp(x))                (5)
    x = k pi/2 + y + yl                Cody-Waite: pi/2 in four parts, |k| <= 2^20             (6)

function                    error     valid for
exp                         0.9 ulp   all x, subnormal results included
expmsq                      1.0 ulp   all x  (exp(-(x*x)) of a libm: up to 500 ulp)
tanh                        1.3 ulp   all x
logistic                    2.5 ulp   all x
sin, cos, sincos            0.9 ulp   |x| <= 2^20 pi/2 = 1.6e6 rad; NaN beyond
sqrt                        0.5 ulp   x >= 0; NaN below
floor, clip, sign, pow2     exact     all x; pow2: whole numbers -1022..1023

NaN gives NaN. Arguments are float64, of one run or of each lane (`drivers.compiled.lanes`).

Source: own Chebyshev fits, computed in 60 digits. Cody and Waite, Software Manual for the
Elementary Functions (1980); Dekker, A floating-point technique for extending the available
precision, Numerische Mathematik 18 (1971), 224-242; Estrin, Organization of computer systems, Proc.
Western Joint Computer Conference (1960), 33-40.
"""

import math

from pcpc.drivers.compiled.deferred import with_numba
from pcpc.drivers.compiled.jit import inline

ROUND = 6755399441055744.0  # 1.5 * 2^52: (x + ROUND) - ROUND is x rounded to whole, |x| < 2^51
WHOLE = 4503599627370496.0  # 2^52: from here on every double is a whole number
SPLIT = 134217729.0  # 2^27 + 1: splits a double into two halves of 26 bits (Dekker)
LOG2_E = 1.4426950408889634
LN2_HIGH, LN2_LOW = 0.6931471805592082, 7.371002565167799e-13  # 40 + 53 bits
TWO_BY_PI = 0.6366197723675814
PI_2A, PI_2B = 1.5707963267341256, 6.077100506303966e-11  # 33 bits each: k times them is exact
PI_2C, PI_2D = 2.0222662487111665e-21, 8.4784276603689e-32
ANGLE_MAX = 1647099.0  # 2^20 pi/2
NAN = float("nan")


def where(c: bool, a: float, b: float) -> float:
    """Return `a if c else b`; it compiles to a select, so both are evaluated.

    For what depends on a state; `if` is for configuration. Raises TypingError (when compiled) if
    `a` or `b` is not float64: -where(c, x, 0) would be 0 interpreted and -0.0 compiled.
    """
    return a if c else b


def pow2(k: float) -> float:
    """Return 2^k for a whole number k in -1022..1023; other k are not checked."""
    return math.ldexp(1.0, int(k)) if k == k else NAN


def sqrt(x: float) -> float:
    """Return the square root, correctly rounded; NaN for x < 0."""
    return math.sqrt(x) if x >= 0.0 else NAN


with_numba("pcpc.executive.laws.emath_types")


@inline
def floor(x: float) -> float:
    """Return the largest whole number not above x; for -0.0 it is 0.0."""
    whole = (abs(x) + WHOLE) - WHOLE
    whole = where(abs(x) < WHOLE, where(x < 0.0, -whole, whole), x)
    return where(whole > x, whole - 1.0, whole)


@inline
def clip(x: float, low: float, high: float) -> float:
    """Return x limited to low..high, low where low > high; NaN stays NaN."""
    below = where(x > high, high, x)  # in this order each line is one instruction
    return where(below < low, low, below)


@inline
def sign(x: float) -> float:
    """Return -1, 0 or 1; a zero keeps its sign, NaN stays NaN."""
    return where(x > 0.0, 1.0, where(x < 0.0, -1.0, x))


@inline
def _exp_reduce(x: float) -> tuple[float, float, float]:
    """Return k, r and r's rounding error, x = k ln2 + r + rl (1); |x| < 760, |r| <= ln2/2."""
    k = (x * LOG2_E + ROUND) - ROUND
    high = x - k * LN2_HIGH
    low = k * LN2_LOW
    r = high - low
    return k, r, (high - r) - low


@inline
def _exp_polynomial(r: float) -> float:
    """Return q(r) = (exp(r) - 1 - r) / r^2 of (2), |r| <= ln2/2."""
    r2 = r * r
    r4 = r2 * r2
    q0 = (0.5 + 0.1666666666666667 * r) + (0.04166666666666667 + 0.008333333333326136 * r) * r2
    q4 = 0.0013888888888883748 + 0.00019841269874820627 * r
    q6 = 2.4801587325547743e-05 + 2.7557255400206422e-06 * r
    q8 = (2.75572736431103e-07 + 2.5105217004720745e-08 * r) + 2.0914686968086876e-09 * r2
    return q0 + ((q4 + q6 * r2) + q8 * r4) * r4


@inline
def _scale(x: float, k: float) -> float:
    """Return x 2^k for 1/2 < x < 2, |k| < 2000, rounded once.

    By two factors, since 2^k itself may lie outside the range of pow2.
    """
    half = (k * 0.5 + ROUND) - ROUND
    return x * pow2(half) * pow2(k - half)


@inline
def exp(x: float) -> float:
    """Return e^x."""
    k, r, rl = _exp_reduce(clip(x, -750.0, 710.0))
    return _scale(1.0 + (r + (r * r * _exp_polynomial(r) + rl)), k)


@inline
def expmsq(x: float) -> float:
    """Return exp(-x^2); the rounding error of x^2 is carried along."""  # (3)
    x = clip(x, -27.5, 27.5)
    high = SPLIT * x
    high = high - (high - x)
    low = x - high
    z = x * x
    zl = ((high * high - z) + 2.0 * high * low) + low * low
    k, r, rl = _exp_reduce(-z)
    rl = rl - zl
    w = r * r * _exp_polynomial(r)
    return _scale(1.0 + (r + (w + rl * (1.0 + (r + w)))), k)


@inline
def _tanh_polynomial(z: float) -> float:
    """Return (tanh(x) / x - 1) / x^2 at z = x^2 <= 0.3025."""
    z2 = z * z
    z4 = z2 * z2
    m0 = -0.3333333333333333 + 0.13333333333332711 * z
    m2 = -0.05396825396743151 + 0.021869488493552625 * z
    m4 = -0.008863234395177999 + 0.003592110343931255 * z
    m6 = -0.0014556615522767396 + 0.00058893468259176 * z
    m8 = (-0.00023463067524526733 + 8.510647287642557e-05 * z) + -2.0598135435770385e-05 * z2
    return (m0 + m2 * z2) + ((m4 + m6 * z2) + m8 * z4) * z4


@inline
def tanh(x: float) -> float:
    """Return the hyperbolic tangent, odd to the last bit."""  # (4)
    size = abs(x)
    size = where(size > 22.0, 22.0, size)  # where tanh rounds to 1
    z = size * size
    near = size + size * z * _tanh_polynomial(z)
    k, r, rl = _exp_reduce(2.0 * size)
    w = r * r * _exp_polynomial(r) + rl
    s = pow2(-k)  # (1 + exp(2x)) / 2^k = s + 1 + r + w, summed with its rounding error
    a = 1.0 + s
    d = a + r
    far = 1.0 - (s + s) / (d + (((a - d) + r) + w))
    t = where(size < 0.55, near, far)
    return where(x == 0.0, x, where(x < 0.0, -t, t))


@inline
def logistic(x: float) -> float:
    """Return 1 / (1 + exp(-x))."""  # (5)
    e = exp(-abs(x))
    return where(x < 0.0, e, 1.0) / (1.0 + e)


@inline
def _angle_reduce(x: float) -> tuple[float, float, float]:
    """Return k modulo 4 as -2..2, y and y's rounding error, x = k pi/2 + y + yl (6)."""
    k = (x * TWO_BY_PI + ROUND) - ROUND
    quadrant = k - 4.0 * ((k * 0.25 + ROUND) - ROUND)
    a = x - k * PI_2A
    w = k * PI_2B
    b = a - w
    e = (a - b) - w
    w = k * PI_2C
    c = b - w
    e = ((b - c) - w) + e
    e = e - k * PI_2D
    y = c + e
    return quadrant, y, (c - y) + e


@inline
def _sin_kernel(y: float, yl: float) -> float:
    """Return sin(y + yl), |y| <= pi/4."""
    z = y * y
    z2 = z * z
    s0 = -0.16666666666666666 + 0.008333333333330946 * z
    s2 = -0.0001984126983675497 + 2.755731610068303e-06 * z
    s4 = -2.5051131455427946e-08 + 1.591810123027412e-10 * z
    return y + (z * y * (s0 + (s2 + s4 * z2) * z2) + (yl - 0.5 * z * yl))


@inline
def _cos_kernel(y: float, yl: float) -> float:
    """Return cos(y + yl), |y| <= pi/4; 1 - z/2 with its rounding error."""
    z = y * y
    z2 = z * z
    c0 = 0.041666666666666664 + -0.0013888888888887395 * z
    c2 = 2.4801587298763433e-05 + -2.755731727056031e-07 * z
    c4 = 2.087614602468733e-09 + -1.1382614868413877e-11 * z
    h = 0.5 * z
    u = 1.0 - h
    return u + (((1.0 - u) - h) + (z2 * (c0 + (c2 + c4 * z2) * z2) - y * yl))


@inline
def sincos(x: float) -> tuple[float, float]:
    """Return sin(x), cos(x) at the price of one; NaN for |x| > 2^20 pi/2."""
    valid = abs(x) <= ANGLE_MAX
    quadrant, y, yl = _angle_reduce(where(valid, x, 0.0))
    s = _sin_kernel(y, yl)
    c = _cos_kernel(y, yl)
    odd = abs(quadrant) == 1.0
    back = abs(quadrant) == 2.0
    sine = where(odd, c, s)
    cosine = where(odd, s, c)
    sine = where(quadrant == -1.0, -sine, where(back, -sine, sine))
    cosine = where(quadrant == 1.0, -cosine, where(back, -cosine, cosine))
    return where(valid, where(x == 0.0, x, sine), NAN), where(valid, cosine, NAN)


@inline
def sin(x: float) -> float:
    """Return the sine; NaN for |x| > 2^20 pi/2."""
    return sincos(x)[0]


@inline
def cos(x: float) -> float:
    """Return the cosine; NaN for |x| > 2^20 pi/2."""
    return sincos(x)[1]
