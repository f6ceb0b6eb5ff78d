/* A device for the probe: the executive's part of docs/device.md, in plain C, on SocketCAN or udp_multicast.

       command = gain (target - position)                 gain 4, target 1, as plants/probe/rig.yaml

   cc -std=c11 -O2 -Wall -Wextra -Wconversion -ffp-contract=off -o probe probe.c
   ./probe BUS [CYCLES [RATE_HZ]]

   BUS      vcan0, socketcan:vcan0, udp_multicast:239.74.163.2:43113
   CYCLES   after as many it stops the run; 0: it goes on until the plant has ended
   RATE_HZ  on a clock of its own; 0: lockstep, each cycle begins with the plant's feedback

   Exit code 0 at the end of a run, 1 if the plant fell silent, 2 for a wrong command line, 4 without a bus. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

/* The DBC file: ids, the scale of both values, the turn of the heartbeat, 100 ms, in cycles of 1 kHz. */
enum { SYNC = 0x080, CMD = 0x0A0, FB = 0x120, HB_EXEC = 0x701, HB_PLANT = 0x702, HEARTBEAT_EVERY = 100 };
enum { READY = 1, RUN = 2, STOP = 5 };                                        /* CMD.mode */
enum { STOPPED = 4, OPERATIONAL = 5, PRE_OPERATIONAL = 127 };                 /* heartbeats */
enum { GREET_MS = 20, PATIENCE_MS = 5000, MAX_DELTA = 4 };
static const double SCALE = 1e-6, GAIN = 4.0, TARGET = 1.0;

typedef struct { uint32_t id; uint8_t n, data[8]; } frame_t;
typedef struct { int rx, tx, is_udp; } bus_t;
typedef struct { int last, fresh, done, met; double position; } input_t;      /* last counter of FB; -1: none yet */

/* ---------------------------------------------------------------- protection: CRC-8 SAE J1850 */

static uint8_t crc8(uint32_t id, const uint8_t *data, int n) {
    uint8_t crc = 0xFF;
    for (int i = -2; i < n; i++) {
        crc ^= i == -2 ? (uint8_t)id : i == -1 ? (uint8_t)(id >> 8) : data[i];
        for (int bit = 0; bit < 8; bit++) crc = (uint8_t)(crc << 1 ^ (crc & 0x80 ? 0x1D : 0));
    }
    return crc ^ 0xFF;
}

/* ---------------------------------------------------------------- signals: 32 bits, Intel, signed */

static int32_t raw_of(double value) {                        /* half to even, saturated */
    double code = value / SCALE, size = code < 0.0 ? -code : code;
    if (!(size < 0x1p52)) size = 0x1p52;
    volatile double sum = size + 0x1p52;                     /* 2^52 leaves no bits for a fraction */
    size = sum - 0x1p52;
    if (size > 2147483647.0) return code < 0.0 ? INT32_MIN : INT32_MAX;
    return (int32_t)(code < 0.0 ? -size : size);
}

static void put32(uint8_t *data, int32_t value) {
    for (int i = 0; i < 4; i++) data[i] = (uint8_t)((uint32_t)value >> 8 * i);
}

static int32_t get32(const uint8_t *data) {
    uint32_t word = 0;
    for (int i = 0; i < 4; i++) word |= (uint32_t)data[i] << 8 * i;
    return (int32_t)word;
}

/* ---------------------------------------------------------------- the bus */

static const uint8_t HEAD[] = "\x8b\xa9timestamp\xcb\0\0\0\0\0\0\0\0\xae" "arbitration_id\xce";
static const uint8_t MIDDLE[] = "\xae" "is_extended_id\xc2\xafis_remote_frame\xc2\xaeis_error_frame\xc2"
                                "\xa7" "channel\xc0\xa3" "dlc";
static const uint8_t TAIL[] = "\xa5is_fd\xc2\xae" "bitrate_switch\xc2\xb5" "error_state_indicator\xc2";

static size_t append(uint8_t *to, size_t at, const void *from, size_t n) {
    memcpy(to + at, from, n);
    return at + n;
}

static int send_frame(const bus_t *bus, const frame_t *frame) {
    if (!bus->is_udp) {
        struct can_frame can = {.can_id = frame->id, .can_dlc = frame->n};
        memcpy(can.data, frame->data, frame->n);
        return send(bus->tx, &can, sizeof can, 0) == (ssize_t)sizeof can;
    }
    uint8_t text[256], id[4], n = frame->n;                  /* python-can: a msgpack map a datagram */
    for (int i = 0; i < 4; i++) id[i] = (uint8_t)(frame->id >> (24 - 8 * i));
    size_t at = append(text, 0, HEAD, sizeof HEAD - 1);
    at = append(text, append(text, at, id, 4), MIDDLE, sizeof MIDDLE - 1);
    text[at++] = n;
    at = append(text, at, "\xa4" "data\xc4", 6);
    text[at++] = n;
    at = append(text, append(text, at, frame->data, n), TAIL, sizeof TAIL - 1);
    return send(bus->tx, text, at, 0) == (ssize_t)at;
}

/* Bytes behind the tag of a msgpack scalar, string or bytes, with the length where there is one; -1: another. */
static long rest_of(const uint8_t *b, size_t at, size_t end) {
    uint8_t tag = b[at];
    if (tag <= 0x7F || tag >= 0xE0 || tag == 0xC0 || tag == 0xC2 || tag == 0xC3) return 0;
    if (tag >= 0xA0 && tag <= 0xBF) return tag & 31;
    if (tag >= 0xCC && tag <= 0xCF) return 1L << (tag - 0xCC);
    if (tag >= 0xD0 && tag <= 0xD3) return 1L << (tag - 0xD0);
    if (tag == 0xCA || tag == 0xCB) return tag == 0xCA ? 4 : 8;
    if ((tag == 0xC4 || tag == 0xD9) && at + 1 < end) return b[at + 1] + 1L;
    return -1;
}

static int unpack(const uint8_t *b, size_t end, frame_t *frame) {
    int has_id = 0, has_data = 0;
    if (end < 1 || (b[0] & 0xF0) != 0x80) return 0;
    size_t at = 1;
    for (int left = b[0] & 15; left > 0; left--) {
        if (at >= end || b[at] < 0xA0 || b[at] > 0xBF) return 0;
        size_t key = at + 1, n = b[at] & 31, value = key + n;
        if (value >= end) return 0;
        long rest = rest_of(b, value, end);
        if (rest < 0 || value + 1 + (size_t)rest > end) return 0;
        if (n == 14 && memcmp(b + key, "arbitration_id", n) == 0) {
            frame->id = b[value] <= 0x7F ? b[value] : 0;
            for (long i = 1; i <= rest; i++) frame->id = frame->id << 8 | b[value + (size_t)i];
            has_id = 1;
        } else if (n == 4 && memcmp(b + key, "data", n) == 0 && b[value] == 0xC4 && rest <= 9) {
            frame->n = (uint8_t)(rest - 1);
            memcpy(frame->data, b + value + 2, frame->n);
            has_data = 1;
        }
        at = value + 1 + (size_t)rest;
    }
    return has_id && has_data;
}

/* Within `wait_ms`: 1, a frame; 0, nothing came; -1, something that is no frame for us. */
static int get_frame(const bus_t *bus, frame_t *frame, int wait_ms) {
    struct pollfd ready = {.fd = bus->rx, .events = POLLIN};
    if (poll(&ready, 1, wait_ms) <= 0) return 0;
    if (bus->is_udp) {
        uint8_t text[512];
        ssize_t n = recv(bus->rx, text, sizeof text, 0);
        return n > 0 && unpack(text, (size_t)n, frame) ? 1 : -1;
    }
    struct can_frame can;
    if (recv(bus->rx, &can, sizeof can, 0) != (ssize_t)sizeof can || can.can_dlc > 8) return -1;
    frame->id = can.can_id;
    frame->n = can.can_dlc;
    memcpy(frame->data, can.data, frame->n);
    return 1;
}

static int open_can(const char *name, bus_t *bus) {
    struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(name)};
    bus->rx = bus->tx = socket(AF_CAN, SOCK_RAW, CAN_RAW);
    return address.can_ifindex && bus->rx >= 0 && bind(bus->rx, (struct sockaddr *)&address, sizeof address) == 0;
}

static int open_udp(const char *channel, bus_t *bus) {       /* GROUP[:PORT], on the loopback interface */
    char group[64];
    int port = 43113, on = 1, buffer = 1 << 22;
    if (sscanf(channel, "%63[^:]:%d", group, &port) < 1) return 0;
    struct in_addr loopback = {.s_addr = htonl(INADDR_LOOPBACK)};
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)}, there = here;
    struct ip_mreq member = {.imr_interface = loopback};
    if (!inet_aton(group, &there.sin_addr)) return 0;
    member.imr_multiaddr = there.sin_addr;
    bus->is_udp = 1;
    bus->rx = socket(AF_INET, SOCK_DGRAM, 0);
    bus->tx = socket(AF_INET, SOCK_DGRAM, 0);
    setsockopt(bus->rx, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    setsockopt(bus->rx, SOL_SOCKET, SO_REUSEPORT, &on, sizeof on);
    setsockopt(bus->rx, SOL_SOCKET, SO_RCVBUF, &buffer, sizeof buffer);
    setsockopt(bus->tx, IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof loopback);
    return bind(bus->rx, (struct sockaddr *)&here, sizeof here) == 0 &&
           setsockopt(bus->rx, IPPROTO_IP, IP_ADD_MEMBERSHIP, &member, sizeof member) == 0 &&
           connect(bus->tx, (struct sockaddr *)&there, sizeof there) == 0;
}

static int open_bus(const char *name, bus_t *bus) {
    if (strncmp(name, "udp_multicast:", 14) == 0) return open_udp(name + 14, bus);
    return open_can(strncmp(name, "socketcan:", 10) == 0 ? name + 10 : name, bus);
}

/* ---------------------------------------------------------------- what the device sends and hears */

static void heartbeat(const bus_t *bus, int state) {
    frame_t frame = {.id = HB_EXEC, .n = 1, .data = {(uint8_t)state}};
    send_frame(bus, &frame);
}

static void send_sync(const bus_t *bus, uint32_t sequence) {
    frame_t frame = {.id = SYNC, .n = 2, .data = {(uint8_t)sequence}};
    frame.data[1] = crc8(SYNC, frame.data, 1);
    send_frame(bus, &frame);
}

/* The frames of cycle k, in the order that the contract asks for. */
static void send_cycle(const bus_t *bus, uint32_t k, uint32_t heartbeat_every, double value, int mode) {
    if (k % heartbeat_every == 0)
        heartbeat(bus, mode == RUN ? OPERATIONAL : mode == STOP ? STOPPED : PRE_OPERATIONAL);
    frame_t frame = {.id = CMD, .n = 8};
    put32(frame.data, raw_of(value));
    frame.data[5] = (uint8_t)(mode << 4);
    frame.data[6] = k & 15;
    frame.data[7] = crc8(CMD, frame.data, 7);
    send_frame(bus, &frame);
    send_sync(bus, k + 1);
}

static void take(input_t *in, const frame_t *frame) {
    if (frame->id == HB_PLANT && frame->n == 1) {
        in->done |= in->met && frame->data[0] == STOPPED;    /* of this run: one that ended before says so, too */
        in->met |= frame->data[0] != STOPPED;
    } else if (frame->id == FB && frame->n == 8 && crc8(FB, frame->data, 7) == frame->data[7]) {
        int counter = frame->data[6] >> 4, delta = in->last < 0 ? 1 : (counter - in->last) & 15;
        in->last = counter;
        if (delta == 0 || delta > MAX_DELTA) return;
        in->position = get32(frame->data) * SCALE;
        in->fresh = 1;
    }
}

/* Greet until the plant is there, then ask for the sample of t = 0. */
static void meet(const bus_t *bus, input_t *in) {
    frame_t frame;
    while (!in->met) {
        heartbeat(bus, PRE_OPERATIONAL);
        if (get_frame(bus, &frame, GREET_MS) > 0) take(in, &frame);
    }
    heartbeat(bus, PRE_OPERATIONAL);
    send_sync(bus, 0);
}

/* Lockstep: until the feedback of the cycle is here; 0: the plant has ended, or fell silent. */
static int await(const bus_t *bus, input_t *in) {
    frame_t frame;
    for (in->fresh = 0; !in->fresh && !in->done;) {
        int came = get_frame(bus, &frame, PATIENCE_MS);
        if (came == 0) return 0;
        if (came > 0) take(in, &frame);
    }
    return !in->done;
}

/* On a clock: until the deadline, then all that is there. */
static int wake(const bus_t *bus, input_t *in, struct timespec *at, long period_ns) {
    frame_t frame;
    at->tv_nsec += period_ns;
    at->tv_sec += at->tv_nsec / 1000000000L;
    at->tv_nsec %= 1000000000L;
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, at, NULL) == EINTR) {}
    for (int came; (came = get_frame(bus, &frame, 0)) != 0;)
        if (came > 0) take(in, &frame);
    return !in->done;
}

int main(int argc, char **argv) {
    if (argc < 2 || argc > 4) return fprintf(stderr, "usage: %s BUS [CYCLES [RATE_HZ]]\n", argv[0]), 2;
    uint32_t cycles = argc > 2 ? (uint32_t)strtoul(argv[2], NULL, 10) : 0;
    double rate_hz = argc > 3 ? strtod(argv[3], NULL) : 0.0;
    uint32_t every = rate_hz >= 10.0 ? (uint32_t)(0.1 * rate_hz) : rate_hz > 0.0 ? 1 : HEARTBEAT_EVERY;
    bus_t bus = {0};
    if (!open_bus(argv[1], &bus)) return fprintf(stderr, "%s: %s\n", argv[1], strerror(errno)), 4;
    input_t in = {.last = -1};
    struct timespec at;
    meet(&bus, &in);
    if (rate_hz > 0.0 && !await(&bus, &in)) return !in.done;
    clock_gettime(CLOCK_MONOTONIC, &at);
    for (uint32_t k = 0; cycles == 0 || k < cycles; k++) {
        int goes_on = rate_hz > 0.0 ? wake(&bus, &in, &at, (long)(1e9 / rate_hz)) : await(&bus, &in);
        if (!goes_on) return !in.done;
        send_cycle(&bus, k, every, GAIN * (TARGET - in.position), k == 0 ? READY : RUN);
    }
    send_cycle(&bus, cycles, every, 0.0, STOP);
    return 0;
}
