/* Wire and codec in plain C: the yardstick of `tools.dev.bench`.
 *
 * The same tables, structs and results as drivers/can/wire.py and codec.py; wire.h, made from
 * the Python modules, gives layouts and constants. For little-endian machines: 8 data bytes are
 * loaded as one word. SocketCAN and python-can's udp_multicast. By hand: what `pcpc generate` writes
 * of a codec is code for each frame, without tables, and main_linux.c of a device opens sockets of
 * its own and polls them, so neither has the sockets and buffers of the Python side.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <sys/socket.h>

#include "wire.h"

typedef struct frames frame_row;
typedef struct signals signal_row;

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "for little-endian machines");

/* -------------------------------------------------------------------- drivers/can/codec.py -------- */

static inline double unscale(int64_t raw, const signal_row *signal)
{
    double factor = signal->factor, offset = signal->offset, code;
    float single;
    int32_t half = (int32_t)raw;
    switch (signal->kind) {
    case SIGNALKIND_SCALED:
        return (double)raw * factor + offset;
    case SIGNALKIND_UNSIGNED_64:
        return (double)(uint64_t)raw * factor + offset;
    case SIGNALKIND_FLOAT_32:
        memcpy(&single, &half, sizeof single);
        code = single;
        break;
    case SIGNALKIND_FLOAT_64:
        memcpy(&code, &raw, sizeof code);
        break;
    default:
        return (double)(raw * signal->int_factor + signal->int_offset);
    }
    return factor == 1.0 && offset == 0.0 ? code : code * factor + offset;
}

static inline void unpack(const uint8_t *data, const frame_row *frame, const signal_row *signals, double *values)
{
    uint64_t little, big;
    memcpy(&little, data, sizeof little);
    big = __builtin_bswap64(little);
    for (int64_t row = frame->first; row < frame->end; row++) {
        const signal_row *signal = &signals[row];
        int64_t word = (int64_t)(signal->big_endian ? big : little);
        int64_t raw = (word >> signal->shift) & signal->mask, sign = signal->sign;
        values[signal->variable] = unscale((raw ^ sign) - sign, signal);
    }
}

static inline double round_even(double x)
{
    double size = __builtin_fabs(x);
    if (size < 0x1p52)
        size = (size + 0x1p52) - 0x1p52;
    return x < 0.0 ? -size : size;
}

static inline int64_t code_bits(double code, int64_t kind)
{
    int64_t bits;
    int32_t half;
    float single = (float)code;
    if (kind == SIGNALKIND_FLOAT_32) {
        memcpy(&half, &single, sizeof half);
        return half;
    }
    if (kind == SIGNALKIND_FLOAT_64) {
        memcpy(&bits, &code, sizeof bits);
        return bits;
    }
    if (code >= 0x1p63)
        return (int64_t)(code - 0x1p63) ^ INT64_MIN;
    return (int64_t)code;
}

static inline int64_t pack(uint8_t *data, const frame_row *frame, const signal_row *signals, const double *values)
{
    uint64_t little = 0, big = 0;
    int64_t saturated = 0;
    for (int64_t row = frame->first; row < frame->end; row++) {
        const signal_row *signal = &signals[row];
        int64_t kind = signal->kind;
        int is_float = kind == SIGNALKIND_FLOAT_32 || kind == SIGNALKIND_FLOAT_64;
        double low = signal->code_low, high = signal->code_high;
        double code = (values[signal->variable] - signal->offset) / signal->factor;
        int64_t bits;
        if (!is_float)
            code = round_even(code);
        if (code != code)
            bits = 0, saturated++;
        else if (code < low)
            bits = is_float ? code_bits(low, kind) : signal->bits_low, saturated++;
        else if (code > high)
            bits = is_float ? code_bits(high, kind) : signal->bits_high, saturated++;
        else
            bits = code_bits(code, kind);
        uint64_t placed = (uint64_t)(bits & signal->mask) << signal->shift;
        if (signal->big_endian)
            big |= placed;
        else
            little |= placed;
    }
    little |= __builtin_bswap64(big);
    memcpy(data, &little, sizeof little);
    return saturated;
}

/* `repeats` times: pack all frames from `values`, unpack all into `found`; tools/dev/bench/codec.py. */
void drive_codec(int64_t repeats, int64_t n, const frame_row *frames, const signal_row *signals, uint8_t (*data)[8], const double *values, double *found)
{
    for (int64_t i = 0; i < repeats; i++) {
        for (int64_t f = 0; f < n; f++)
            pack(data[f], &frames[f], signals, values);
        for (int64_t f = 0; f < n; f++)
            unpack(data[f], &frames[f], signals, found);
    }
}

/* --------------------------------------------------------------------- drivers/can/wire.py -------- */

#define NO "\xC2"
#define TO_ID "\x8B" "\xA9" "timestamp" "\xCB\0\0\0\0\0\0\0\0" "\xAE" "arbitration_id" "\xCE"
#define TO_EXTENDED TO_ID "\0\0\0\0" "\xAE" "is_extended_id"
#define TO_DLC TO_EXTENDED NO "\xAF" "is_remote_frame" NO "\xAE" "is_error_frame" NO \
    "\xA7" "channel" "\xC0" "\xA3" "dlc"
#define TO_LENGTH TO_DLC "\x08" "\xA4" "data" "\xC4"
#define TAIL "\xA5" "is_fd" NO "\xAE" "bitrate_switch" NO "\xB5" "error_state_indicator" NO
#define LEN(text) (sizeof(text) - 1)
#define IS(text) (n == LEN(text) && memcmp(b + key, text, LEN(text)) == 0)

void prepare_packet(struct wire *wire)
{
    memcpy(wire->packet_tx, TO_LENGTH, LEN(TO_LENGTH));
}

static inline int64_t write_packet(const uint8_t *frame, uint8_t *packet)
{
    uint32_t word;
    memcpy(&word, frame, sizeof word);
    uint32_t id = __builtin_bswap32(word & 0x1FFFFFFF);
    int64_t n = frame[4] < 8 ? frame[4] : 8;
    memcpy(packet + LEN(TO_ID), &id, sizeof id);
    packet[LEN(TO_EXTENDED)] = word >> 31 ? 0xC3 : 0xC2;
    packet[LEN(TO_DLC)] = packet[LEN(TO_LENGTH)] = n;
    memcpy(packet + LEN(TO_LENGTH) + 1, frame + 8, n);
    memcpy(packet + LEN(TO_LENGTH) + 1 + n, TAIL, LEN(TAIL));
    return LEN(TO_LENGTH) + 1 + n + LEN(TAIL);
}

static inline int64_t value_end(const uint8_t *b, int64_t at, int64_t end)
{
    int64_t length = -1;
    uint8_t tag = b[at];
    if (tag <= 0x7F || tag >= 0xE0)
        length = 0;
    else if (tag >= 0xA0 && tag <= 0xBF)
        length = tag & 31;
    else
        switch (tag) {
        case 0xC0: case 0xC2: case 0xC3: length = 0; break;
        case 0xCC: case 0xD0: length = 1; break;
        case 0xCD: case 0xD1: length = 2; break;
        case 0xCA: case 0xCE: case 0xD2: length = 4; break;
        case 0xCB: case 0xCF: case 0xD3: length = 8; break;
        case 0xC4: case 0xD9: length = at + 1 < end ? b[at + 1] + 1 : -1; break;
        }
    return length < 0 || at + 1 + length > end ? -1 : at + 1 + length;
}

static inline int64_t whole_number(const uint8_t *b, int64_t at, int64_t stop)
{
    int64_t value = 0;
    if (b[at] <= 0x7F)
        return b[at];
    if (b[at] == 0xC2 || b[at] == 0xC3)
        return b[at] - 0xC2;
    if (b[at] < 0xCC || b[at] > 0xCE)
        return -1;
    for (int64_t i = at + 1; i < stop; i++)
        value = value << 8 | b[i];
    return value;
}

static inline int read_packet(const uint8_t *b, int64_t end, uint8_t *frame)
{
    int64_t id = -1, data_at = 0, data_n = -1, at = 1;
    int other = 0, extended = 0;
    if (end < 2 || end > WIRE_PACKET_BYTES - 1 || (b[0] & 0xF0) != 0x80)
        return 0;
    for (int field = 0; field < (b[0] & 15); field++) {
        if (at >= end || b[at] < 0xA1 || b[at] > 0xBF)
            return 0;
        int64_t n = b[at] & 31, key = at + 1, value = key + n;
        if (value >= end || (at = value_end(b, value, end)) < 0)
            return 0;
        if (IS("arbitration_id")) {
            id = whole_number(b, value, at);
        } else if (IS("data")) {
            if (b[value] != 0xC4)
                return 0;
            data_at = value + 2, data_n = b[value + 1];
        } else if (IS("is_extended_id")) {
            extended = whole_number(b, value, at) == 1;
        } else if (IS("is_remote_frame") || IS("is_error_frame") || IS("is_fd")) {
            other |= whole_number(b, value, at) != 0;
        }
    }
    if (other || at != end || id < 0 || id > (extended ? 0x1FFFFFFF : 0x7FF) || data_n < 0
        || data_n > 8)
        return 0;
    uint32_t word = (uint32_t)id | (uint32_t)extended << 31;
    memcpy(frame, &word, sizeof word);
    frame[4] = data_n;
    memset(frame + 8, 0, 8);
    memcpy(frame + 8, b + data_at, data_n);
    return 1;
}

static inline int put_frame(struct wire *wire)
{
    const void *what = wire->tx;
    int64_t n = WIRE_CLASSIC_BYTES;
    if (wire->kind == MEDIUM_UDP)
        what = wire->packet_tx, n = write_packet(wire->tx, wire->packet_tx);
    if (send(wire->fd_tx, what, n, MSG_DONTWAIT) == n)
        return 1;
    wire->errno_ = errno;
    return 0;
}

static inline int get_frame(struct wire *wire, int block)
{
    int64_t n;
    int known, flags = block ? 0 : MSG_DONTWAIT;
    if (wire->kind == MEDIUM_SOCKETCAN) {
        n = recv(wire->fd_rx, wire->rx, WIRE_CLASSIC_BYTES, flags);
        if (n == WIRE_CLASSIC_BYTES && wire->rx[3] & WIRE_ERROR_FLAG)
            return ARRIVAL_BUS_ERROR;
        known = n == WIRE_CLASSIC_BYTES && !(wire->rx[3] & WIRE_ERROR_FLAGS);
    } else {
        socklen_t *size = (socklen_t *)wire->address_bytes;
        *size = WIRE_ADDRESS_BYTES;
        n = recvfrom(wire->fd_rx, wire->packet_rx, WIRE_PACKET_BYTES, flags,
                     (struct sockaddr *)wire->address, size);
        wire->source = wire->address[0];
        if (n >= 0 && (wire->source == wire->own[0] || wire->source == wire->own[1]))
            return ARRIVAL_OWN;
        known = n > 0 && read_packet(wire->packet_rx, n, wire->rx);
    }
    if (n >= 0)
        return known ? ARRIVAL_FRAME : ARRIVAL_FOREIGN;
    if (errno == EAGAIN || errno == EINTR)
        return ARRIVAL_NOTHING;
    wire->errno_ = errno;
    return ARRIVAL_FAILED;
}

/* Send and receive `count` frames in turn; return those received. tools/dev/bench/frame.py. */
int64_t drive_frames(struct wire *wire, int64_t count)
{
    int64_t received = 0;
    for (int64_t i = 0; i < count; i++) {
        wire->tx[8] = i;
        put_frame(wire);
        received += get_frame(wire, 1) == ARRIVAL_FRAME;
    }
    return received;
}

/* For device_cycle.c, which knows nothing of the record: frames as struct can_frame. */
int put_raw(struct wire *wire, const uint8_t frame[WIRE_CLASSIC_BYTES])
{
    memcpy(wire->tx, frame, WIRE_CLASSIC_BYTES);
    return put_frame(wire);
}

/* 1: a frame; 0: nothing is there; -1: something else came. */
int get_raw(struct wire *wire, uint8_t frame[WIRE_CLASSIC_BYTES])
{
    int arrival = get_frame(wire, 0);
    if (arrival == ARRIVAL_FRAME)
        memcpy(frame, wire->rx, WIRE_CLASSIC_BYTES);
    return arrival == ARRIVAL_FRAME ? 1 : arrival == ARRIVAL_NOTHING || arrival == ARRIVAL_FAILED ? 0 : -1;
}

/* The least that a snapshot of 256 variables costs; tools/dev/bench/cycle.py. */
void drive_copy(uint8_t *to, const uint8_t *from, int64_t bytes, int64_t repeats)
{
    for (int64_t i = 0; i < repeats; i++) {
        memcpy(to, from, bytes);
        __asm__ volatile("" ::: "memory");
    }
}
