/* Sum and difference of doubles in software, rounded as IEEE 754 asks for, half to even.

   For a Cortex-M without double in hardware: libgcc's own (gcc 12) is one bit off now and then, as in
   1 - 0x1.3e26c2c5006c4p-33. The linker puts these in their place: --wrap=__aeabi_dadd, and so on. */
#include <stdint.h>

#define SIGN 0x8000000000000000u
#define INFINITE 0x7FF0000000000000u
#define NOT_A_NUMBER 0x7FF8000000000000u
#define HIDDEN 0x0010000000000000u
#define GUARD 10u /* bits behind the last one of a double; the lowest gathers what is lost */

#if defined(__arm__)
#define RUN_TIME __attribute__((pcs("aapcs"))) /* in general registers, whatever -mfloat-abi says */
#else
#define RUN_TIME
#endif

RUN_TIME double __wrap___aeabi_dadd(double a, double b);
RUN_TIME double __wrap___aeabi_dsub(double a, double b);
RUN_TIME double __wrap___aeabi_drsub(double a, double b);
double soft_sum(double a, double b);

typedef union {
    double number;
    uint64_t bits;
} double_bits;

static uint64_t fraction_of(uint64_t size)
{
    uint64_t hidden = (size >= HIDDEN) ? HIDDEN : 0u;
    return ((size & (HIDDEN - 1u)) | hidden) << GUARD;
}

static int32_t exponent_of(uint64_t size)
{
    int32_t exponent = (int32_t)(size >> 52);
    return (exponent == 0) ? 1 : exponent; /* of subnormal numbers: that of the least normal one */
}

static uint64_t shifted(uint64_t fraction, int32_t by)
{
    if (by == 0) {
        return fraction;
    }
    if (by > 63) {
        return (fraction != 0u) ? 1u : 0u;
    }
    uint64_t lost = fraction << (64 - by);
    return (fraction >> by) | ((lost != 0u) ? 1u : 0u);
}

/* Round a fraction with its guard bits; its leading bit is the 63rd, or the number is subnormal. */
static uint64_t rounded(uint64_t fraction, int32_t exponent)
{
    uint64_t rest = fraction & ((1u << GUARD) - 1u);
    uint64_t whole = fraction >> GUARD;
    uint64_t half = 1u << (GUARD - 1u);
    if ((rest > half) || ((rest == half) && ((whole & 1u) != 0u))) {
        whole += 1u; /* a carry goes into the exponent */
    }
    uint64_t size = whole + ((uint64_t)(uint32_t)(exponent - 1) << 52);
    return (size < INFINITE) ? size : INFINITE;
}

static uint64_t sum_of(uint64_t large, uint64_t small) /* |large| >= |small| */
{
    uint64_t sign = large & SIGN;
    uint64_t a = large & ~SIGN;
    uint64_t b = small & ~SIGN;
    int32_t exponent = exponent_of(a);
    uint64_t fraction = fraction_of(a);
    uint64_t other = shifted(fraction_of(b), exponent - exponent_of(b));
    if (a >= INFINITE) {
        return ((a > INFINITE) || ((b == INFINITE) && (((large ^ small) & SIGN) != 0u))) ? NOT_A_NUMBER : large;
    }
    if (((large ^ small) & SIGN) == 0u) {
        fraction += other;
        if (fraction >= (HIDDEN << (GUARD + 1u))) {
            fraction = shifted(fraction, 1);
            exponent += 1;
        }
    } else {
        fraction -= other;
        if (fraction == 0u) {
            return 0u; /* +0; -0 - 0 went the other way */
        }
        while ((fraction < (HIDDEN << GUARD)) && (exponent > 1)) {
            fraction <<= 1;
            exponent -= 1;
        }
    }
    return sign | rounded(fraction, exponent);
}

double soft_sum(double a, double b)
{
    double_bits x;
    double_bits y;
    x.number = a;
    y.number = b;
    if ((x.bits & ~SIGN) >= (y.bits & ~SIGN)) {
        x.bits = sum_of(x.bits, y.bits);
    } else {
        x.bits = sum_of(y.bits, x.bits);
    }
    return x.number;
}

static double negative(double a)
{
    double_bits x;
    x.number = a;
    x.bits ^= SIGN;
    return x.number;
}

double __wrap___aeabi_dadd(double a, double b)
{
    return soft_sum(a, b);
}

double __wrap___aeabi_dsub(double a, double b)
{
    return soft_sum(a, negative(b));
}

double __wrap___aeabi_drsub(double a, double b)
{
    return soft_sum(b, negative(a));
}
