"""`pcpc_math.h` and `pcpc_math.c`: the elementary functions in C, translated from emath.

With the self-test, which refuses a build with other bits.
"""

from collections.abc import Callable
from typing import Any

from pcpc.executive.laws import emath
from pcpc.tools.make.generate.translator import points
from pcpc.tools.make.generate.translator.kinds import FLOAT, Cells, Number
from pcpc.tools.make.generate.translator.source import comment
from pcpc.tools.make.generate.translator.unit import Unit, wrapped_lines

NAMES = ("floor", "clip", "sign", "exp", "expmsq", "tanh", "logistic", "sincos", "sin", "cos")
FLAGS = ("-std=c99", "-ffp-contract=off")

_HEAD = """\
#ifndef PCPC_MATH_H
#define PCPC_MATH_H

#include <stdbool.h>
#include <stdint.h>

#if defined(__FAST_MATH__)
#error "-ffast-math changes bits; compile without it"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif
#if defined(__x86_64__)
#include <emmintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#define PCPC_NAN (__builtin_nan(""))
#define PCPC_INFINITY (__builtin_inf())

/* A double and its bits. */
typedef union {
    double number;
    uint64_t bits;
} pcpc_bits;

/* Return the square root of a positive number by its bits: rounded exactly, without a libm. */
double pcpc_soft_sqrt(double x);

/* Return 0 if this machine, as pcpc_math.c was compiled for it, gives the bits of every other. */
int32_t pcpc_selftest(void);

/* Return whether the compiler joins a product and a sum: then it was not told -ffp-contract=off. */
static inline bool pcpc_contracts(void)
{
    const volatile double factor = 134217729.0; /* 2^27 + 1: the square needs 55 bits */
    const double a = factor;
    const double b = -18014398777917440.0;

    return (a * a + b) != 0.0;
}

/* Return |x|. */
static inline double pcpc_abs(double x)
{
    return __builtin_fabs(x);
}

/* Return x without its fraction: 0 for NaN, beyond the range of int32_t the nearest one. */
static inline int32_t pcpc_whole(double x)
{
    if (x >= 2147483647.0) {
        return INT32_MAX;
    }
    if (x <= -2147483648.0) {
        return INT32_MIN;
    }
    return (x == x) ? (int32_t)x : 0;
}

/* Return the square root, correctly rounded; NaN for x < 0. */
static inline double pcpc_sqrt(double x)
{
#if defined(__x86_64__)
    return _mm_cvtsd_f64(_mm_sqrt_sd(_mm_setzero_pd(), _mm_set_sd(x)));
#elif defined(__aarch64__)
    return vget_lane_f64(vsqrt_f64(vdup_n_f64(x)), 0);
#elif defined(__ARM_FP) && ((__ARM_FP & 8) != 0)
    double root;
    __asm__("vsqrt.f64 %P0, %P1" : "=w"(root) : "w"(x));
    return root;
#elif defined(__wasm__)
    return __builtin_sqrt(x);
#else
    return pcpc_soft_sqrt(x);
#endif
}

/* Return 2^k for a whole number k in -1022..1023; other k are not checked. */
static inline double pcpc_pow2(double k)
{
    pcpc_bits shifted;

    shifted.number = k + PCPC_ROUND;
    shifted.bits = (shifted.bits + 1023U) << 52;
    return shifted.number;
}
"""

_SOFT_SQRT = """\
double pcpc_soft_sqrt(double x)
{
    pcpc_bits v;

    v.number = x;
    if (!(x > 0.0) || (v.bits >= 0x7FF0000000000000U)) {
        return ((x == 0.0) || (x > 0.0)) ? x : PCPC_NAN; /* +-0, infinity; below 0 and NaN */
    }
    int32_t exponent = (int32_t)(v.bits >> 52);
    uint64_t rest = v.bits & 0xFFFFFFFFFFFFFU;
    if (exponent == 0) { /* subnormal: shift until the leading bit is in its place */
        exponent = 1;
        while (rest < 0x10000000000000U) {
            rest <<= 1;
            exponent -= 1;
        }
    } else {
        rest |= 0x10000000000000U;
    }
    exponent -= 1023;
    if ((exponent & 1) != 0) { /* an even power of 2 before the root */
        rest <<= 1;
        exponent -= 1;
    }
    /* bit by bit: root^2 <= rest; 53 bits and one to round by */
    uint64_t root = 0U;
    uint64_t sum = 0U;
    rest <<= 1;
    for (uint64_t bit = 0x20000000000000U; bit != 0U; bit >>= 1) {
        const uint64_t trial = sum + bit;
        if (trial <= rest) {
            sum = trial + bit;
            rest -= trial;
            root += bit;
        }
        rest <<= 1;
    }
    root += root & 1U; /* a root is never in the middle of two doubles */
    v.bits = (root >> 1) + ((uint64_t)((exponent / 2) + 1022) << 52);
    return v.number;
}
"""

_SELFTEST = """\
int32_t pcpc_selftest(void)
{{
    uint64_t digest = 14695981039346656037U;

    for (int32_t i = 0; i < {points}; i += 1) {{
        double values[{values}];
        {name}((double)i, values);
        for (int32_t n = 0; n < {values}; n += 1) {{
            pcpc_bits v;
            v.number = values[n];
            for (int32_t byte = 0; byte < 8; byte += 1) {{
                digest = (digest ^ ((v.bits >> (8 * byte)) & 255U)) * 1099511628211U;
            }}
        }}
    }}
    if (pcpc_contracts()) {{
        return 1; /* compile with -ffp-contract=off */
    }}
    return (digest == {digest}U) ? 0 : 2; /* 2: other bits, by rounding mode or flush to zero */
}}
"""


class _Math(Unit):
    """The file of the elementary functions themselves."""

    prefix = "PCPC_"

    def elementary(self, function: Callable[..., Any]) -> tuple[str, tuple[Number, ...]]:
        name = function.__name__
        if name in ("pow2", "sqrt"):
            return f"pcpc_{name}", (FLOAT,)
        count = function.__code__.co_argcount
        called = self.function(function, (FLOAT,) * count, None, None)  # type: ignore[arg-type]
        return called.name, called.results

    def _function_name(self, function: Callable[..., Any]) -> str:
        return f"pcpc_{function.__name__.strip('_')}"


def files() -> dict[str, str]:
    """Return the texts of both files by their names."""
    unit = _Math("pcpc")
    unit.constant("ROUND", emath.ROUND)
    for name in NAMES:
        unit.elementary(getattr(getattr(emath, name), "py_func", getattr(emath, name)))
    functions = [
        line.replace("static ", "static inline ", 1) if line.startswith("static ") else line
        for line in unit.function_lines([emath.__name__])
    ]
    test = _Math("pcpc")
    evaluate = getattr(points.evaluate, "py_func", points.evaluate)
    called = test.function(evaluate, (FLOAT, Cells((points.VALUES,))), None, None)  # type: ignore[arg-type]
    doc = f"{emath.__doc__}\n\nMade by `pcpc generate c` from executive/laws/emath.py."
    constants = unit.constant_lines()
    own = [line for line in test.constant_lines() if line not in constants]
    head, _, primitives = _HEAD.partition("/* A double and its bits")
    header = [
        *comment(doc),
        head,
        *constants,
        "",
        f"/* A double and its bits{primitives}",
        *functions,
        "#endif /* PCPC_MATH_H */",
        "",
    ]
    fill = {"points": points.POINTS, "values": points.VALUES, "name": called.name}
    body = [
        "/* The square root without a libm, and the self-test of the elementary functions. */",
        "",
        '#include "pcpc_math.h"',
        "",
        *own,
        "",
        *(p for n in called.lines for p in wrapped_lines(n)),
        "",
        _SOFT_SQRT,
        _SELFTEST.format(digest=hex(points.DIGEST), **fill),
    ]
    return {"pcpc_math.h": "\n".join(header), "pcpc_math.c": "\n".join(body)}
