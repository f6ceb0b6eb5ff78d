/* Elementary functions in single precision: + - * /, comparison and select only.
 *
 * The methods are those of pcpc_math.h, with the constants of 24 bits: no double anywhere, so that a
 * Cortex-M4 computes all of it in its floating-point unit. The bits are the same on every machine
 * that computes in float (FLT_EVAL_METHOD 0) and joins no product with a sum: -ffp-contract=off.
 *
 *     function                    error     valid for
 *     pcpc_expf                   0.98 ulp  all x, subnormal results included
 *     pcpc_expmsqf                0.91 ulp  all x
 *     pcpc_tanhf                  1.31 ulp  all x
 *     pcpc_logisticf              2.41 ulp  all x
 *     pcpc_sinf, cosf, sincosf    0.84 ulp  |x| <= 12867 rad (2^13 pi/2); NaN beyond
 *     pcpc_sqrtf                  0.5 ulp   x >= 0; NaN below
 *     floorf, clipf, signf        exact     all x
 *
 * Errors: the most over all floats, against a libm in double. Polynomials: own Chebyshev fits.
 */
#ifndef PCPC_MATHF_H
#define PCPC_MATHF_H

#include <float.h>
#include <stdbool.h>
#include <stdint.h>

#if defined(__FAST_MATH__)
#error "-ffast-math changes bits; compile without it"
#endif
#if defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD != 0)
#error "this machine computes float in another precision: other bits"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif
#if defined(__x86_64__)
#include <xmmintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#define PCPC_NANF (__builtin_nanf(""))
#define PCPC_INFINITYF (__builtin_inff())

static const float PCPC_ROUNDF = 12582912.0f; /* 1.5 2^23: x + ROUND - ROUND is whole, |x| < 2^22 */
static const float PCPC_WHOLEF = 8388608.0f;  /* 2^23: from here on every float is whole */
static const float PCPC_SPLITF = 4097.0f;     /* 2^12 + 1: two halves of 12 bits (Dekker) */
static const float PCPC_LOG2_EF = 1.442695f;
static const float PCPC_LN2_HIGHF = 0.693145751953125f; /* 16 bits: k times it is exact */
static const float PCPC_LN2_LOWF = 1.4286068e-06f;
static const float PCPC_TWO_BY_PIF = 0.63661975f;
static const float PCPC_PI_2AF = 1.5703125f; /* 11 bits each: k times them is exact */
static const float PCPC_PI_2BF = 0.0004837512969970703f;
static const float PCPC_PI_2CF = 7.549533620476723e-08f;
static const float PCPC_PI_2DF = 2.563344e-12f;
static const float PCPC_ANGLE_MAXF = 12867.0f;

/* A float and its bits. */
typedef union {
    float number;
    uint32_t bits;
} pcpc_bitsf;

/* Return the square root of a positive number by its bits: rounded exactly, without a libm. */
float pcpc_soft_sqrtf(float x);

/* Return 0 if this machine, as pcpc_mathf.c was compiled for it, gives the bits of every other. */
int32_t pcpc_selftestf(void);

/* Return whether the compiler joins a product and a sum: then it was not told -ffp-contract=off. */
static inline bool pcpc_contractsf(void)
{
    const volatile float factor = 4097.0f; /* 2^12 + 1: the square needs 25 bits */
    const float a = factor;
    const float b = -16785408.0f;

    return (a * a + b) != 0.0f;
}

/* Return |x|. */
static inline float pcpc_absf(float x)
{
    return __builtin_fabsf(x);
}

/* Return x without its fraction: 0 for NaN, beyond the range of int32_t the nearest one. */
static inline int32_t pcpc_wholef(float x)
{
    if (x >= 2147483648.0f) {
        return INT32_MAX;
    }
    if (x <= -2147483648.0f) {
        return INT32_MIN;
    }
    return (x == x) ? (int32_t)x : 0;
}

/* Return the square root, correctly rounded; NaN for x < 0. */
static inline float pcpc_sqrtf(float x)
{
#if defined(__x86_64__)
    return _mm_cvtss_f32(_mm_sqrt_ss(_mm_set_ss(x)));
#elif defined(__aarch64__)
    return vget_lane_f32(vsqrt_f32(vdup_n_f32(x)), 0);
#elif defined(__ARM_FP) && ((__ARM_FP & 4) != 0)
    float root;
    __asm__("vsqrt.f32 %0, %1" : "=t"(root) : "t"(x));
    return root;
#elif defined(__wasm__)
    return __builtin_sqrtf(x);
#else
    return pcpc_soft_sqrtf(x);
#endif
}

/* Return 2^k for a whole number k in -126..127; other k are not checked. */
static inline float pcpc_pow2f(float k)
{
    pcpc_bitsf shifted;

    shifted.number = k + PCPC_ROUNDF;
    shifted.bits = (shifted.bits + 127U) << 23;
    return shifted.number;
}

/* Return the largest whole number not above x; for -0.0f it is 0.0f. */
static inline float pcpc_floorf(float x)
{
    const float size = pcpc_absf(x);
    float whole = (size + PCPC_WHOLEF) - PCPC_WHOLEF;

    whole = (size < PCPC_WHOLEF) ? ((x < 0.0f) ? -whole : whole) : x;
    return (whole > x) ? whole - 1.0f : whole;
}

/* Return x limited to low..high, low where low > high; NaN stays NaN. */
static inline float pcpc_clipf(float x, float low, float high)
{
    const float below = (x > high) ? high : x;

    return (below < low) ? low : below;
}

/* Return -1, 0 or 1; a zero keeps its sign, NaN stays NaN. */
static inline float pcpc_signf(float x)
{
    return (x > 0.0f) ? 1.0f : ((x < 0.0f) ? -1.0f : x);
}

/* Write k, r and r's rounding error, x = k ln2 + r + rl; |x| < 105, |r| <= ln2/2. */
static inline void pcpc_exp_reducef(float x, float *k_out, float *r_out, float *rl_out)
{
    const float k = (x * PCPC_LOG2_EF + PCPC_ROUNDF) - PCPC_ROUNDF;
    const float high = x - k * PCPC_LN2_HIGHF;
    const float low = k * PCPC_LN2_LOWF;
    const float r = high - low;

    *k_out = k;
    *r_out = r;
    *rl_out = (high - r) - low;
}

/* Return (exp(r) - 1 - r) / r^2, |r| <= ln2/2. */
static inline float pcpc_exp_polynomialf(float r)
{
    const float r2 = r * r;

    return (0.5f + 0.16666576f * r) + ((0.041666552f + 0.008363346f * r) + 0.0013926392f * r2) * r2;
}

/* Return x 2^k for 1/2 < x < 2, |k| < 250, rounded once: 2^k itself may be out of range. */
static inline float pcpc_scalef(float x, float k)
{
    const float half = (k * 0.5f + PCPC_ROUNDF) - PCPC_ROUNDF;

    return x * pcpc_pow2f(half) * pcpc_pow2f(k - half);
}

/* Return e^x. */
static inline float pcpc_expf(float x)
{
    float k;
    float r;
    float rl;

    pcpc_exp_reducef(pcpc_clipf(x, -104.0f, 89.0f), &k, &r, &rl);
    return pcpc_scalef(1.0f + (r + (r * r * pcpc_exp_polynomialf(r) + rl)), k);
}

/* Return exp(-x^2); the rounding error of x^2 is carried along. */
static inline float pcpc_expmsqf(float x)
{
    const float size = pcpc_clipf(x, -10.25f, 10.25f);
    const float split = PCPC_SPLITF * size;
    const float high = split - (split - size);
    const float low = size - high;
    const float z = size * size;
    const float zl = ((high * high - z) + 2.0f * high * low) + low * low;
    float k;
    float r;
    float rl;

    pcpc_exp_reducef(-z, &k, &r, &rl);
    rl = rl - zl;
    const float w = r * r * pcpc_exp_polynomialf(r);
    return pcpc_scalef(1.0f + (r + (w + rl * (1.0f + (r + w)))), k);
}

/* Return (tanh(x) / x - 1) / x^2 at z = x^2 <= 0.3025. */
static inline float pcpc_tanh_polynomialf(float z)
{
    const float z2 = z * z;
    const float m0 = -0.33333334f + 0.13333324f * z;
    const float m2 = -0.053964697f + 0.021818403f * z;
    const float m4 = -0.008526141f + 0.002526109f * z;

    return m0 + (m2 + m4 * z2) * z2;
}

/* Return the hyperbolic tangent, odd to the last bit. */
static inline float pcpc_tanhf(float x)
{
    float size = pcpc_absf(x);
    float k;
    float r;
    float rl;

    size = (size > 9.1f) ? 9.1f : size; /* where tanh rounds to 1 */
    const float z = size * size;
    const float near = size + size * z * pcpc_tanh_polynomialf(z);
    pcpc_exp_reducef(2.0f * size, &k, &r, &rl);
    const float w = r * r * pcpc_exp_polynomialf(r) + rl;
    const float s = pcpc_pow2f(-k); /* (1 + exp(2x)) / 2^k = s + 1 + r + w, with its rounding error */
    const float a = 1.0f + s;
    const float d = a + r;
    const float far = 1.0f - (s + s) / (d + (((a - d) + r) + w));
    const float t = (size < 0.55f) ? near : far;
    return (x == 0.0f) ? x : ((x < 0.0f) ? -t : t);
}

/* Return 1 / (1 + exp(-x)). */
static inline float pcpc_logisticf(float x)
{
    const float e = pcpc_expf(-pcpc_absf(x));

    return ((x < 0.0f) ? e : 1.0f) / (1.0f + e);
}

/* Write k modulo 4 as -2..2, y and y's rounding error, x = k pi/2 + y + yl. */
static inline void pcpc_angle_reducef(float x, float *quadrant_out, float *y_out, float *yl_out)
{
    const float k = (x * PCPC_TWO_BY_PIF + PCPC_ROUNDF) - PCPC_ROUNDF;
    const float a = x - k * PCPC_PI_2AF;
    float w = k * PCPC_PI_2BF;
    const float b = a - w;
    float e = (a - b) - w;

    *quadrant_out = k - 4.0f * ((k * 0.25f + PCPC_ROUNDF) - PCPC_ROUNDF);
    w = k * PCPC_PI_2CF;
    const float c = b - w;
    e = ((b - c) - w) + e;
    e = e - k * PCPC_PI_2DF;
    const float y = c + e;
    *y_out = y;
    *yl_out = (c - y) + e;
}

/* Return sin(y + yl), |y| <= pi/4. */
static inline float pcpc_sin_kernelf(float y, float yl)
{
    const float z = y * y;
    const float s = (-0.16666667f + 0.008333332f * z) + (-0.00019840083f + 2.7249314e-06f * z) * (z * z);

    return y + (z * y * s + (yl - 0.5f * z * yl));
}

/* Return cos(y + yl), |y| <= pi/4; 1 - z/2 with its rounding error. */
static inline float pcpc_cos_kernelf(float y, float yl)
{
    const float z = y * y;
    const float c = 0.041666664f + (-0.00138883f + 2.4547437e-05f * z) * z;
    const float h = 0.5f * z;
    const float u = 1.0f - h;

    return u + (((1.0f - u) - h) + (z * z * c - y * yl));
}

/* Write sin(x), cos(x) at the price of one; NaN for |x| > 12867. */
static inline void pcpc_sincosf(float x, float *sine_out, float *cosine_out)
{
    const bool valid = pcpc_absf(x) <= PCPC_ANGLE_MAXF;
    float quadrant;
    float y;
    float yl;

    pcpc_angle_reducef(valid ? x : 0.0f, &quadrant, &y, &yl);
    const float s = pcpc_sin_kernelf(y, yl);
    const float c = pcpc_cos_kernelf(y, yl);
    const bool odd = pcpc_absf(quadrant) == 1.0f;
    const bool back = pcpc_absf(quadrant) == 2.0f;
    float sine = odd ? c : s;
    float cosine = odd ? s : c;
    sine = ((quadrant == -1.0f) || back) ? -sine : sine;
    cosine = ((quadrant == 1.0f) || back) ? -cosine : cosine;
    *sine_out = valid ? ((x == 0.0f) ? x : sine) : PCPC_NANF;
    *cosine_out = valid ? cosine : PCPC_NANF;
}

/* Return the sine; NaN for |x| > 12867. */
static inline float pcpc_sinf(float x)
{
    float sine;
    float cosine;

    pcpc_sincosf(x, &sine, &cosine);
    return sine;
}

/* Return the cosine; NaN for |x| > 12867. */
static inline float pcpc_cosf(float x)
{
    float sine;
    float cosine;

    pcpc_sincosf(x, &sine, &cosine);
    return cosine;
}

#endif /* PCPC_MATHF_H */
