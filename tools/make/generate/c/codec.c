#include "codec.h"

#define TWO_52 4503599627370496.0 /* doubles from here on are integers */
#define TWO_63 9223372036854775808.0
#define MAX_DELTA 4u /* a gap of the counter up to which a frame is used; of drivers.can.e2e */

/* ------------------------------------------------------------------------------------ signals */

/* Half to even: adding 2^52 leaves no bits for a fraction. */
static double nearest(double x)
{
    double size = (x < 0.0) ? -x : x;
    if (size < TWO_52) {
        size = (size + TWO_52) - TWO_52;
    }
    return (x < 0.0) ? -size : size;
}

static uint64_t bits_of(double code)
{
    if (code >= TWO_63) {
        return (uint64_t)(int64_t)(code - TWO_63) ^ (1ull << 63);
    }
    return (uint64_t)(int64_t)code;
}

uint64_t raw_of(double value, const scale_t *scale, uint32_t *clamped)
{
    double code = nearest((value - scale->offset) / scale->factor);
    if (code < scale->low) {
        *clamped += 1u;
        return scale->low_bits;
    }
    if (code > scale->high) {
        *clamped += 1u;
        return scale->high_bits;
    }
    if (!(code >= scale->low)) {
        *clamped += 1u;
        return 0u;
    }
    return bits_of(code);
}

static double within(double value, const scale_t *scale, uint32_t *clamped)
{
    double code = (value - scale->offset) / scale->factor;
    if (code < scale->low) {
        *clamped += 1u;
        return scale->low;
    }
    if (code > scale->high) {
        *clamped += 1u;
        return scale->high;
    }
    if (!(code >= scale->low)) {
        *clamped += 1u;
        return 0.0;
    }
    return code;
}

uint64_t raw_of_float32(double value, const scale_t *scale, uint32_t *clamped)
{
    union { float number; uint32_t bits; } word;
    word.number = (float)within(value, scale, clamped);
    return word.bits;
}

uint64_t raw_of_float64(double value, const scale_t *scale, uint32_t *clamped)
{
    union { double number; uint64_t bits; } word;
    word.number = within(value, scale, clamped);
    return word.bits;
}

int64_t signed_of(uint64_t raw, uint32_t bits)
{
    uint64_t sign = 1ull << (bits - 1u);
    return (int64_t)((raw ^ sign) - sign);
}

/* -0.0 as 0.0. A function, since gcc 12 takes -(double)i for a number that cannot be -0.0. */
double plus_zero(double value)
{
    return (value == 0.0) ? 0.0 : value;
}

double float32_of(uint64_t raw)
{
    union { float number; uint32_t bits; } word;
    word.bits = (uint32_t)raw;
    return (double)word.number;
}

double float64_of(uint64_t raw)
{
    union { double number; uint64_t bits; } word;
    word.bits = raw;
    return word.number;
}

uint64_t get_little(const uint8_t data[8])
{
    uint64_t word = 0u;
    for (uint32_t i = 0u; i < 8u; i++) {
        word |= (uint64_t)data[i] << (8u * i);
    }
    return word;
}

uint64_t get_big(const uint8_t data[8])
{
    uint64_t word = 0u;
    for (uint32_t i = 0u; i < 8u; i++) {
        word |= (uint64_t)data[i] << (56u - (8u * i));
    }
    return word;
}

void put_words(uint8_t data[8], uint64_t little, uint64_t big)
{
    for (uint32_t i = 0u; i < 8u; i++) {
        data[i] = (uint8_t)(((little >> (8u * i)) | (big >> (56u - (8u * i)))) & 0xFFu);
    }
}

/* --------------------------------------------------------------------------------- protection */

static uint8_t crc8_byte(uint8_t crc, uint8_t byte)
{
    uint32_t sum = (uint32_t)crc ^ byte;
    for (uint32_t bit = 0u; bit < 8u; bit++) {
        sum = ((sum & 0x80u) != 0u) ? ((sum << 1) ^ 0x1Du) : (sum << 1);
    }
    return (uint8_t)(sum & 0xFFu);
}

/* CRC-8 SAE J1850 over two bytes of the id, low first, and `n` of data. */
static uint8_t crc8(uint32_t id, const uint8_t data[ROOM], uint8_t n)
{
    uint8_t crc = crc8_byte(0xFFu, (uint8_t)(id & 0xFFu));
    crc = crc8_byte(crc, (uint8_t)((id >> 8) & 0xFFu));
    for (uint8_t i = 0u; i < n; i++) {
        crc = crc8_byte(crc, data[i]);
    }
    return (uint8_t)(crc ^ 0xFFu);
}

static uint16_t crc16_byte(uint16_t crc, uint8_t byte)
{
    uint32_t sum = (uint32_t)crc ^ ((uint32_t)byte << 8);
    for (uint32_t bit = 0u; bit < 8u; bit++) {
        sum = ((sum & 0x8000u) != 0u) ? ((sum << 1) ^ 0x1021u) : (sum << 1);
    }
    return (uint16_t)(sum & 0xFFFFu);
}

/* CRC-16 CCITT-FALSE over all data but the two bytes at `place`, and two of the data id. */
static uint16_t crc16(uint16_t data_id, const uint8_t data[ROOM], uint8_t place, uint8_t n)
{
    uint16_t crc = 0xFFFFu;
    for (uint8_t i = 0u; i < n; i++) {
        if ((i != place) && (i != (uint8_t)(place + 1u))) {
            crc = crc16_byte(crc, data[i]);
        }
    }
    crc = crc16_byte(crc, (uint8_t)(data_id & 0xFFu));
    return crc16_byte(crc, (uint8_t)(data_id >> 8));
}

static bool right_crc(const uint8_t data[ROOM], const frame_info *frame)
{
    uint8_t at = frame->crc_byte;
    if (frame->protection == (uint8_t)CRC_8) {
        return crc8(frame->id, data, at) == data[at];
    }
    uint16_t there = (uint16_t)(data[at] | ((uint32_t)data[at + 1u] << 8));
    return crc16(frame->data_id, data, at, frame->n) == there;
}

/* Write counter, modulo its width, and CRC into packed data. */
void protect(uint8_t data[ROOM], const frame_info *frame, uint32_t counter)
{
    uint8_t at = frame->crc_byte;
    if (frame->protection == (uint8_t)UNPROTECTED) {
        return;
    }
    uint32_t mask = (uint32_t)frame->counter_mask << frame->counter_shift;
    uint32_t placed = (counter & frame->counter_mask) << frame->counter_shift;
    uint32_t kept = data[frame->counter_byte] & ~mask;
    data[frame->counter_byte] = (uint8_t)((kept | placed) & 0xFFu);
    if (frame->protection == (uint8_t)CRC_8) {
        data[at] = crc8(frame->id, data, at);
    } else {
        uint16_t crc = crc16(frame->data_id, data, at, frame->n);
        data[at] = (uint8_t)(crc & 0xFFu);
        data[at + 1u] = (uint8_t)(crc >> 8);
    }
}

/* Judge a frame that came. `lost` grows by those missing before it: a burst is counted in full, a
   counter that jumps at will is not believed. Decode it only if it is used. */
judgement judge(const uint8_t data[ROOM], uint8_t n, const frame_info *frame, receiver_t *state, uint32_t *lost)
{
    if ((n != frame->n) || ((frame->protection != (uint8_t)UNPROTECTED) && !right_crc(data, frame))) {
        return WRONG_CRC;
    }
    if (frame->protection == (uint8_t)UNPROTECTED) {
        state->fresh = true;
        return USED;
    }
    uint32_t mask = frame->counter_mask;
    uint32_t counter = ((uint32_t)data[frame->counter_byte] >> frame->counter_shift) & mask;
    uint32_t delta = (state->last >= 0) ? ((counter - (uint32_t)state->last) & mask) : 1u;
    if (delta == 0u) {
        return REPEATED;
    }
    uint32_t missing = delta - 1u;
    if (delta > MAX_DELTA) {
        uint32_t turns = state->still_cycles / frame->every_n;
        uint32_t most = (turns > 1u) ? (turns - 1u) : 0u;
        missing = (missing < most) ? missing : most;
    }
    state->last = (int32_t)counter;
    state->still_cycles = 0u;
    *lost += missing;
    if (delta > MAX_DELTA) {
        return WRONG_SEQUENCE;
    }
    state->fresh = true;
    return (delta == 1u) ? USED : USED_SOME_LOST;
}
