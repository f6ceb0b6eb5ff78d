#include "slcan.h"

#define CR '\r'
#define BEL '\a'
#if PCPC_FD

static const uint8_t LENGTHS[16] = {0u, 1u, 2u, 3u, 4u, 5u, 6u, 7u, 8u, 12u, 16u, 20u, 24u, 32u, 48u, 64u};
#endif

static int32_t digit_of(char c)
{
    if ((c >= '0') && (c <= '9')) {
        return c - '0';
    }
    if ((c >= 'A') && (c <= 'F')) {
        return (c - 'A') + 10;
    }
    if ((c >= 'a') && (c <= 'f')) {
        return (c - 'a') + 10;
    }
    return -1;
}

/* `n` digits from `at` on; false: there is something else. */
static bool hex(const slcan_t *slcan, uint32_t at, uint32_t n, uint32_t *value)
{
    *value = 0u;
    for (uint32_t i = at; i < (at + n); i++) {
        int32_t digit = (i < slcan->n) ? digit_of(slcan->line[i]) : -1;
        if (digit < 0) {
            return false;
        }
        *value = (*value << 4) | (uint32_t)digit;
    }
    return true;
}

static bool to_frame(const slcan_t *slcan, uint32_t digits, frame_t *frame)
{
    uint32_t n = 0u;
#if PCPC_FD
    if (!hex(slcan, 1u, digits, &frame->id) || !hex(slcan, digits + 1u, 1u, &n)) {
#else
    if (!hex(slcan, 1u, digits, &frame->id) || !hex(slcan, digits + 1u, 1u, &n) || (n > 8u)) {
#endif
        return false;
    }
#if PCPC_FD
    char kind = slcan->line[0];
    bool is_fd = (kind != 't') && (kind != 'T');
    if (!is_fd && (n > 8u)) {
        return false;
    }
    n = LENGTHS[n];
    frame->flags = ((kind == 'b') || (kind == 'B')) ? 5u : (is_fd ? 4u : 0u);
#endif
    frame->n = (uint8_t)n;
    for (uint32_t i = 0u; i < n; i++) {
        uint32_t byte = 0u;
        if (!hex(slcan, digits + 2u + (2u * i), 2u, &byte)) {
            return false;
        }
        frame->data[i] = (uint8_t)byte;
    }
    if (digits == 8u) {
        frame->id |= FRAME_EXTENDED;
    }
    return slcan->n == (digits + 2u + (2u * n));
}

static bool obey(slcan_t *slcan, frame_t *frame)
{
    bool came = false;
    slcan->reply = CR;
    switch (slcan->line[0]) {
    case 't':
#if PCPC_FD
    case 'd':
    case 'D':
    case 'b':
    case 'B':
#endif
    case 'T':
#if PCPC_FD
        came = slcan->open && to_frame(slcan, (slcan->line[0] >= 'a') ? 3u : 8u, frame);
#else
        came = slcan->open && to_frame(slcan, (slcan->line[0] == 't') ? 3u : 8u, frame);
#endif
        slcan->reply = came ? '\0' : BEL;
        break;
    case 'O':
    case 'C':
        slcan->open = slcan->line[0] == 'O';
        break;
    case 'S':
        break;
    default:
        slcan->reply = BEL;
        break;
    }
    return came;
}

bool slcan_take(slcan_t *slcan, char c, frame_t *frame)
{
    bool came = false;
    slcan->reply = '\0';
    if (c != CR) {
        if (slcan->n < SLCAN_LINE) {
            slcan->line[slcan->n] = c;
            slcan->n += 1u;
        }
    } else {
        if (slcan->n > 0u) { /* hosts send empty lines to begin anew */
            came = obey(slcan, frame);
        }
        slcan->n = 0u;
    }
    return came;
}

uint32_t slcan_line(const frame_t *frame, char line[SLCAN_LINE + 1u])
{
    static const char DIGITS[] = "0123456789ABCDEF";
    bool extended = (frame->id & FRAME_EXTENDED) != 0u;
    uint32_t digits = extended ? 8u : 3u;
    uint32_t at = 0u;
#if PCPC_FD
    line[at++] = ((frame->flags & 4u) == 0u) ? 't' : (((frame->flags & 1u) != 0u) ? 'b' : 'd');
    if (extended) {
        line[0] = (char)(line[0] - ('a' - 'A'));
    }
#else
    line[at++] = extended ? 'T' : 't';
#endif
    for (uint32_t i = 0u; i < digits; i++) {
        uint32_t shift = 4u * (digits - 1u - i);
        line[at++] = DIGITS[((frame->id & ~FRAME_EXTENDED) >> shift) & 15u];
    }
#if PCPC_FD
    uint32_t code = 0u;
    while ((code < 15u) && (LENGTHS[code] < frame->n)) {
        code++;
    }
    line[at++] = DIGITS[code];
#else
    line[at++] = (char)('0' + (char)frame->n);
#endif
    for (uint32_t i = 0u; i < frame->n; i++) {
        line[at++] = DIGITS[frame->data[i] >> 4];
        line[at++] = DIGITS[frame->data[i] & 15u];
    }
    line[at++] = CR;
    return at;
}
