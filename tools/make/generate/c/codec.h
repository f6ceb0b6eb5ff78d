/* Signals, CRCs and counters of CAN frames, as the rig's DBC file means them (pcpc, docs/device.md).

       value = raw factor + offset
       raw   = round half to even((value - offset) / factor), within the limits; NaN is raw 0

   No libc, no allocation, no I/O. Compile with -ffp-contract=off. */
#ifndef CODEC_H
#define CODEC_H

#include <stdbool.h>
#include <stdint.h>

#define UNLIMITED 1.7976931348623157e308
#define FRAME_EXTENDED 0x80000000u /* in an id: one of 29 bits, as in SocketCAN */

typedef struct {
    uint32_t id;
    uint8_t n; /* bytes, at most ROOM */
    uint8_t data[ROOM];
#if PCPC_FD
    uint8_t flags; /* 1 bit rate switch, 2 error state indicator, 4 CAN FD */
#endif
} frame_t;

enum { UNPROTECTED = 0, CRC_8 = 1, CRC_16 = 2 };

/* What there is to know of a frame, besides its signals. */
typedef struct {
    uint32_t id;
    uint32_t every_n; /* cycles from one transmission to the next */
    uint16_t data_id; /* of CRC_16 */
    uint8_t n;
    uint8_t protection;
    uint8_t counter_byte;
    uint8_t counter_shift;
    uint8_t counter_mask;
    uint8_t crc_byte;
    bool sync;
    bool awaited; /* of every cycle and no SYNC */
    bool heartbeat;
    bool emergency; /* sent when the error code changes */
#if PCPC_FD
    uint8_t flags; /* of its frame_t */
#endif
} frame_info;

/* How a signal of integers lies between raw and value. */
typedef struct {
    double factor;
    double offset;
    double low; /* the lowest raw number, and its bits */
    double high;
    uint64_t low_bits;
    uint64_t high_bits;
} scale_t;

/* The state of the receiver of a frame. */
typedef struct {
    int32_t last; /* counter; -1 before the first frame */
    uint32_t still_cycles;
    bool fresh; /* one was used in this cycle */
    bool met;   /* a heartbeat: its node is there */
} receiver_t;

typedef enum { USED, USED_SOME_LOST, REPEATED, WRONG_SEQUENCE, WRONG_CRC } judgement;

uint64_t raw_of(double value, const scale_t *scale, uint32_t *clamped);
uint64_t raw_of_float32(double value, const scale_t *scale, uint32_t *clamped);
uint64_t raw_of_float64(double value, const scale_t *scale, uint32_t *clamped);
int64_t signed_of(uint64_t raw, uint32_t bits);
double plus_zero(double value);
double float32_of(uint64_t raw);
double float64_of(uint64_t raw);

uint64_t get_little(const uint8_t data[8]);
uint64_t get_big(const uint8_t data[8]);
void put_words(uint8_t data[8], uint64_t little, uint64_t big);

void protect(uint8_t data[ROOM], const frame_info *frame, uint32_t counter);
judgement judge(const uint8_t data[ROOM], uint8_t n, const frame_info *frame, receiver_t *state, uint32_t *lost);

#endif
