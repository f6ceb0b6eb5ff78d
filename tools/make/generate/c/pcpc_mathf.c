/* The square root in single precision without a libm, and the self-test of pcpc_mathf.h. */

#include "pcpc_mathf.h"

#define POINTS 200
#define DIGEST 0xDDCDA4E0U

float pcpc_soft_sqrtf(float x)
{
    pcpc_bitsf v;

    v.number = x;
    if (!(x > 0.0f) || (v.bits >= 0x7F800000U)) {
        return ((x == 0.0f) || (x > 0.0f)) ? x : PCPC_NANF; /* +-0, infinity; below 0 and NaN */
    }
    int32_t exponent = (int32_t)(v.bits >> 23);
    uint32_t rest = v.bits & 0x7FFFFFU;
    if (exponent == 0) { /* subnormal: shift until the leading bit is in its place */
        exponent = 1;
        while (rest < 0x800000U) {
            rest <<= 1;
            exponent -= 1;
        }
    } else {
        rest |= 0x800000U;
    }
    exponent -= 127;
    if ((exponent & 1) != 0) { /* an even power of 2 before the root */
        rest <<= 1;
        exponent -= 1;
    }
    /* bit by bit: root^2 <= rest; 24 bits and one to round by */
    uint32_t root = 0U;
    uint32_t sum = 0U;
    rest <<= 1;
    for (uint32_t bit = 0x1000000U; bit != 0U; bit >>= 1) {
        const uint32_t trial = sum + bit;
        if (trial <= rest) {
            sum = trial + bit;
            rest -= trial;
            root += bit;
        }
        rest <<= 1;
    }
    root += root & 1U; /* a root is never in the middle of two floats */
    v.bits = (root >> 1) + ((uint32_t)((exponent / 2) + 126) << 23);
    return v.number;
}

/* Mix a value into a digest: FNV-1a over its bytes, low byte first. */
static uint32_t mixed(uint32_t digest, float value)
{
    pcpc_bitsf v;

    v.number = value;
    for (int32_t byte = 0; byte < 4; byte += 1) {
        digest = (digest ^ ((v.bits >> (8 * byte)) & 255U)) * 16777619U;
    }
    return digest;
}

int32_t pcpc_selftestf(void)
{
    uint32_t digest = 2166136261U;

    for (int32_t i = 0; i < POINTS; i += 1) {
        const float t = (float)i * 0.61803399f; /* its multiples modulo 1 spread evenly over 0..1 */
        const float s = 2.0f * (t - pcpc_floorf(t)) - 1.0f;
        const float wide = s * s * s;
        float sine;
        float cosine;
        pcpc_sincosf(PCPC_ANGLE_MAXF * wide, &sine, &cosine);
        digest = mixed(digest, pcpc_expf(103.0f * wide)); /* some results are subnormal */
        digest = mixed(digest, pcpc_expmsqf(10.1f * s));
        digest = mixed(digest, pcpc_tanhf(9.0f * wide));
        digest = mixed(digest, pcpc_logisticf(103.0f * wide));
        digest = mixed(digest, sine);
        digest = mixed(digest, cosine);
        digest = mixed(digest, pcpc_sqrtf(1e-38f * pcpc_absf(wide)));
        digest = mixed(digest, pcpc_floorf(1e4f * wide));
        digest = mixed(digest, pcpc_clipf(s, -0.3f, 0.7f));
        digest = mixed(digest, pcpc_signf(s));
    }
    if (pcpc_contractsf()) {
        return 1; /* compile with -ffp-contract=off */
    }
    return (digest == DIGEST) ? 0 : 2; /* 2: other bits, by rounding mode or flush to zero */
}
