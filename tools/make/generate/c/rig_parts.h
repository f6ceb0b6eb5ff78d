/* What every rig has besides its own blocks and frames: names are those of the rig's variables. */
#ifndef RIG_PARTS_H
#define RIG_PARTS_H

#include "codec.h"

typedef struct {
    double state; /* 0 INIT, 1 READY, 2 RUN, 3 HOLD, 4 FAULT, 5 STOP */
    double fault; /* 0 none, else the reason of FAULT */
    double gain;  /* share of the command that is sent: 1, or on a ramp to safe */
    double missing_cycles;
    double nmt;       /* heartbeat */
    double fallback;  /* 0: no other law takes over */
    double saturated; /* 1 if a value sent in the previous cycle was clamped */
    double status_word;
    double error_code;
    double error_register;
} supervisor_t;

typedef struct {
    uint32_t frames_sent;
    uint32_t frames_received;
    uint32_t frames_lost;
    uint32_t crc_errors;
    uint32_t frames_repeated;
    uint32_t wrong_sequence;
    uint32_t saturated_values;
    uint32_t held_cycles;
    uint32_t stale_cycles;
} counts_t;

/* The counts as of the previous cycle. */
typedef struct {
    double passes;
    double frames_sent;
    double frames_received;
    double frames_lost;
    double crc_errors;
    double frames_repeated;
    double wrong_sequence;
    double saturated_values;
    double held_cycles;
    double stale_cycles;
} health_t;

/* Bounds of a value that is sent; `rate`: the most that it may change by in a cycle. */
typedef struct {
    double *value;
    double low;
    double high;
    double rate;
    double safe;
} limit_t;

typedef bool (*finite_t)(const double *values, uint32_t n);

#endif
