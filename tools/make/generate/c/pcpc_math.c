/* The square root without a libm, and the self-test of the elementary functions. */

#include "pcpc_math.h"

/* CONSTANTS */

/* FUNCTIONS */

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

int32_t pcpc_selftest(void)
{
    uint64_t digest = 14695981039346656037U;

    for (int32_t i = 0; i < POINTS; i += 1) {
        double values[VALUES];
        EVALUATE((double)i, values);
        for (int32_t n = 0; n < VALUES; n += 1) {
            pcpc_bits v;
            v.number = values[n];
            for (int32_t byte = 0; byte < 8; byte += 1) {
                digest = (digest ^ ((v.bits >> (8 * byte)) & 255U)) * 1099511628211U;
            }
        }
    }
    if (pcpc_contracts()) {
        return 1; /* compile with -ffp-contract=off */
    }
    return (digest == DIGESTU) ? 0 : 2; /* 2: other bits, by rounding mode or flush to zero */
}
