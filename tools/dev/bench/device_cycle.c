/* Drives the device that `pcpc generate c RIG --device` writes, as tools/dev/bench/cycle.py drives the
 * executive: in memory, and on the sockets of frame.c. By hand: a device's own main_linux.c is paced
 * by a clock and ends with its run. */
#define _GNU_SOURCE
#include <string.h>
#include <time.h>

#include "device.h"

enum { KEPT = 64 };

struct wire;
int put_raw(struct wire *wire, const uint8_t frame[16]);
int get_raw(struct wire *wire, uint8_t frame[16]);

frame_t kept[KEPT]; /* what the last cycle sent */
uint32_t kept_frames;
static struct wire *bus;

static void keep(const frame_t *frame)
{
    kept[kept_frames++ % KEPT] = *frame;
}

static void put(const frame_t *frame)
{
    uint8_t raw[16] = {0};
    memcpy(raw, &frame->id, sizeof frame->id);
    raw[4] = frame->n;
    memcpy(raw + 8, frame->data, sizeof frame->data);
    put_raw(bus, raw);
}

static void hear(const uint8_t raw[16])
{
    uint32_t id;
    memcpy(&id, raw, sizeof id);
    device_frame(id, raw + 8, raw[4]);
}

static int64_t now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

/* Begin anew, on `wire` or, NULL, in memory; 0 if this C does not give the bits of pcpc. */
int begin(struct wire *wire)
{
    bus = wire;
    return device_init(0u, wire ? put : keep);
}

void drive_memory(const uint8_t (*frames)[16], const int64_t *ends, int64_t cycles, int64_t repeats)
{
    for (int64_t r = 0; r < repeats; r++) {
        int64_t i = 0;
        for (int64_t k = 0; k < cycles; k++) {
            for (; i < ends[k]; i++)
                hear(frames[i]);
            kept_frames = 0;
            device_cycle(1u);
        }
    }
}

void drive_bus(struct wire *peer, const uint8_t (*frames)[16], const int64_t *ends, int64_t cycles,
               int64_t period_ns, int64_t *took_ns)
{
    int64_t i = 0;
    for (int64_t k = 0; k < cycles; k++) {
        for (; i < ends[k]; i++)
            put_raw(peer, frames[i]);
        int64_t began = now(), deadline = began - period_ns / 2;
        struct timespec until = {deadline / 1000000000, deadline % 1000000000};
        uint8_t raw[16];
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
        for (int came; (came = get_raw(bus, raw)) != 0;)
            if (came > 0)
                hear(raw);
        device_cycle(1u);
        took_ns[k] = now() - began;
    }
}
