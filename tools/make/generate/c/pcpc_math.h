/* HEADER */
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


/* CONSTANTS */

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

/* FUNCTIONS */
#endif /* PCPC_MATH_H */
