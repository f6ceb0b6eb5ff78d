/* The device as a program on Linux, on SocketCAN or udp_multicast.

       device BUS [CYCLES [RATE_HZ]]

   BUS      vcan0, socketcan:vcan0, udp_multicast:239.74.163.2:43113
   CYCLES   after as many it stops the run; 0: it goes on until the plant has ended; else the rig's
   RATE_HZ  on a clock of its own; 0: lockstep, each cycle begins with the plant's feedback

   Exit code 0 at the end of a run, 1 if the plant fell silent, 2 for a wrong command line, 4 without
   a bus or where it was not compiled to give pcpc's bits, 5 after a fault. */
#include <arpa/inet.h>
#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "port.h"
#include "rig.h"
#include "run.h"

static struct {
    int rx, tx;
    bool is_udp;
} bus;
static struct timespec deadline;
static long period_ns;

/* ---------------------------------------------------------------- python-can's udp_multicast */

static const uint8_t HEAD[] = "\x8b\xa9timestamp\xcb\0\0\0\0\0\0\0\0\xae" "arbitration_id\xce";
static const uint8_t EXTENDED[] = "\xae" "is_extended_id";
static const uint8_t MIDDLE[] = "\xafis_remote_frame\xc2\xaeis_error_frame\xc2\xa7" "channel\xc0\xa3" "dlc";
static const uint8_t TAIL[] = "\xa5is_fd\xc2\xae" "bitrate_switch\xc2\xb5" "error_state_indicator\xc2";

static size_t append(uint8_t *to, size_t at, const void *from, size_t n)
{
    memcpy(to + at, from, n);
    return at + n;
}

/* A msgpack map a datagram; returns its length. */
static size_t to_packet(const frame_t *frame, uint8_t *text)
{
    uint32_t id = frame->id & ~FRAME_EXTENDED;
    uint8_t word[4];
    for (int i = 0; i < 4; i++) {
        word[i] = (uint8_t)(id >> (24 - 8 * i));
    }
    size_t at = append(text, 0, HEAD, sizeof HEAD - 1);
    at = append(text, at, word, 4);
    at = append(text, at, EXTENDED, sizeof EXTENDED - 1);
    text[at++] = (frame->id & FRAME_EXTENDED) != 0 ? 0xC3 : 0xC2;
    at = append(text, at, MIDDLE, sizeof MIDDLE - 1);
    text[at++] = frame->n;
    at = append(text, at, "\xa4" "data\xc4", 6);
    text[at++] = frame->n;
    at = append(text, at, frame->data, frame->n);
#if PCPC_FD
    at = append(text, at, TAIL, sizeof TAIL - 1);
    text[at - 40] = (frame->flags & 4) != 0 ? 0xC3 : 0xC2;
    text[at - 24] = (frame->flags & 1) != 0 ? 0xC3 : 0xC2;
    return at;
#else
    return append(text, at, TAIL, sizeof TAIL - 1);
#endif
}

/* Bytes behind the tag of a msgpack scalar, string or bytes, with the length where there is one; -1: another. */
static long rest_of(const uint8_t *b, size_t at, size_t end)
{
    uint8_t tag = b[at];
    if (tag <= 0x7F || tag >= 0xE0 || tag == 0xC0 || tag == 0xC2 || tag == 0xC3) {
        return 0;
    }
    if (tag >= 0xA0 && tag <= 0xBF) {
        return tag & 31;
    }
    if (tag >= 0xCC && tag <= 0xCF) {
        return 1L << (tag - 0xCC);
    }
    if (tag >= 0xD0 && tag <= 0xD3) {
        return 1L << (tag - 0xD0);
    }
    if (tag == 0xCA || tag == 0xCB) {
        return tag == 0xCA ? 4 : 8;
    }
    if ((tag == 0xC4 || tag == 0xD9) && at + 1 < end) {
        return b[at + 1] + 1L;
    }
    return -1;
}

static bool is(const uint8_t *key, size_t n, const char *word)
{
    return n == strlen(word) && memcmp(key, word, n) == 0;
}

static bool from_packet(const uint8_t *b, size_t end, frame_t *frame)
{
#if PCPC_FD
    frame->flags = 0;
#endif
    bool has_id = false, has_data = false, extended = false, other = false;
    if (end < 1 || (b[0] & 0xF0) != 0x80) {
        return false;
    }
    size_t at = 1;
    for (int left = b[0] & 15; left > 0; left--) {
        if (at >= end || b[at] < 0xA0 || b[at] > 0xBF) {
            return false;
        }
        const uint8_t *key = b + at + 1;
        size_t n = b[at] & 31, value = at + 1 + n;
        if (value >= end) {
            return false;
        }
        long rest = rest_of(b, value, end);
        if (rest < 0 || value + 1 + (size_t)rest > end) {
            return false;
        }
        if (is(key, n, "arbitration_id")) {
            frame->id = b[value] <= 0x7F ? b[value] : 0;
            for (long i = 1; i <= rest; i++) {
                frame->id = frame->id << 8 | b[value + (size_t)i];
            }
            has_id = true;
        } else if (is(key, n, "is_extended_id")) {
            extended = b[value] == 0xC3;
#if PCPC_FD
        } else if (is(key, n, "is_remote_frame") || is(key, n, "is_error_frame")) {
#else
        } else if (is(key, n, "is_remote_frame") || is(key, n, "is_error_frame") || is(key, n, "is_fd")) {
#endif
            other = other || b[value] == 0xC3;
#if PCPC_FD
        } else if (is(key, n, "is_fd")) {
            frame->flags |= b[value] == 0xC3 ? 4 : 0;
        } else if (is(key, n, "bitrate_switch")) {
            frame->flags |= b[value] == 0xC3 ? 1 : 0;
        } else if (is(key, n, "data") && b[value] == 0xC4 && rest <= 65) {
#else
        } else if (is(key, n, "data") && b[value] == 0xC4 && rest <= 9) {
#endif
            frame->n = (uint8_t)(rest - 1);
            memcpy(frame->data, b + value + 2, frame->n);
            has_data = true;
        }
        at = value + 1 + (size_t)rest;
    }
    frame->id |= extended ? FRAME_EXTENDED : 0;
#if PCPC_FD
    frame->flags = (frame->flags & 4) != 0 ? frame->flags : 0;
    return has_id && has_data && !other && (frame->n <= 8 || frame->flags != 0);
#else
    return has_id && has_data && !other;
#endif
}

/* ---------------------------------------------------------------- the bus */

static bool open_can(const char *name)
{
    struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(name)};
#if PCPC_FD
    int on = 1;
#endif
    bus.rx = bus.tx = socket(AF_CAN, SOCK_RAW, CAN_RAW);
#if PCPC_FD
    if (setsockopt(bus.rx, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on) != 0) {
        return false;
    }
#endif
    return address.can_ifindex && bus.rx >= 0 && bind(bus.rx, (struct sockaddr *)&address, sizeof address) == 0;
}

static bool open_udp(const char *channel) /* GROUP[:PORT], on the loopback interface */
{
    char group[64];
    int port = 43113, on = 1, buffer = 1 << 22;
    if (sscanf(channel, "%63[^:]:%d", group, &port) < 1) {
        return false;
    }
    struct in_addr loopback = {.s_addr = htonl(INADDR_LOOPBACK)};
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)}, there = here;
    struct ip_mreq member = {.imr_interface = loopback};
    if (!inet_aton(group, &there.sin_addr)) {
        return false;
    }
    member.imr_multiaddr = there.sin_addr;
    bus.is_udp = true;
    bus.rx = socket(AF_INET, SOCK_DGRAM, 0);
    bus.tx = socket(AF_INET, SOCK_DGRAM, 0);
    setsockopt(bus.rx, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    setsockopt(bus.rx, SOL_SOCKET, SO_REUSEPORT, &on, sizeof on);
    setsockopt(bus.rx, SOL_SOCKET, SO_RCVBUF, &buffer, sizeof buffer);
    setsockopt(bus.tx, IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof loopback);
    return bind(bus.rx, (struct sockaddr *)&here, sizeof here) == 0 &&
           setsockopt(bus.rx, IPPROTO_IP, IP_ADD_MEMBERSHIP, &member, sizeof member) == 0 &&
           connect(bus.tx, (struct sockaddr *)&there, sizeof there) == 0;
}

static bool open_bus(const char *name)
{
    if (strncmp(name, "udp_multicast:", 14) == 0) {
        return open_udp(name + 14);
    }
    return open_can(strncmp(name, "socketcan:", 10) == 0 ? name + 10 : name);
}

void port_send(const frame_t *frame)
{
    ssize_t sent, wanted;
    if (bus.is_udp) {
        uint8_t text[256];
        size_t n = to_packet(frame, text);
        wanted = (ssize_t)n;
        sent = send(bus.tx, text, n, 0);
    } else {
#if PCPC_FD
        struct canfd_frame can = {
            .can_id = frame->id, .len = frame->n, .flags = frame->flags};
#else
        struct can_frame can = {.can_id = frame->id, .can_dlc = frame->n};
#endif
        memcpy(can.data, frame->data, frame->n);
#if PCPC_FD
        size_t size = (frame->flags & 4) != 0 ? CANFD_MTU : CAN_MTU;
        wanted = (ssize_t)size;
        sent = send(bus.tx, &can, size, 0);
#else
        wanted = (ssize_t)sizeof can;
        sent = send(bus.tx, &can, sizeof can, 0);
#endif
    }
    if (sent != wanted) {
        fprintf(stderr, "bus: %s\n", strerror(errno));
        exit(4);
    }
}

static bool own(uint32_t id)
{
    for (uint32_t row = 0; row < RIG_SENT; row++) {
        if (rig_sent[row].id == id) {
            return true;
        }
    }
    return false;
}

int32_t port_receive(frame_t *frame, uint32_t wait_ms)
{
    struct pollfd ready = {.fd = bus.rx, .events = POLLIN};
    if (poll(&ready, 1, (int)wait_ms) <= 0) {
        return 0;
    }
    if (bus.is_udp) {
        uint8_t text[512];
        ssize_t n = recv(bus.rx, text, sizeof text, 0);
        return n > 0 && from_packet(text, (size_t)n, frame) && !own(frame->id) ? 1 : -1;
    }
#if PCPC_FD
    struct canfd_frame can;
#else
    struct can_frame can;
#endif
    uint32_t other = CAN_RTR_FLAG | CAN_ERR_FLAG;
#if PCPC_FD
    ssize_t size = recv(bus.rx, &can, sizeof can, 0);
    if ((size != CAN_MTU || can.len > 8) && (size != CANFD_MTU || can.len > 64)) {
        return -1;
    }
    if ((can.can_id & other) != 0) {
#else
    if (recv(bus.rx, &can, sizeof can, 0) != (ssize_t)sizeof can || can.can_dlc > 8 || (can.can_id & other) != 0) {
#endif
        return -1;
    }
    frame->id = can.can_id;
#if PCPC_FD
    frame->n = can.len;
    frame->flags = size == CANFD_MTU ? (uint8_t)(can.flags | 4) : 0;
#else
    frame->n = can.can_dlc;
#endif
    memcpy(frame->data, can.data, frame->n);
    return 1;
}

/* ---------------------------------------------------------------- the clock */

static long late_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (now.tv_sec - deadline.tv_sec) * 1000000000L + (now.tv_nsec - deadline.tv_nsec);
}

uint32_t port_sleep(void)
{
    uint32_t periods = 0;
    if (deadline.tv_sec == 0 && deadline.tv_nsec == 0) {
        clock_gettime(CLOCK_MONOTONIC, &deadline);
    }
    do { /* whole periods that are over are skipped */
        deadline.tv_nsec += period_ns;
        deadline.tv_sec += deadline.tv_nsec / 1000000000L;
        deadline.tv_nsec %= 1000000000L;
        periods++;
    } while (late_ns() > 0);
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, NULL) == EINTR) {
    }
    return periods;
}

int main(int argc, char **argv)
{
    static const int CODE[] = {[RUN_ENDED] = 0, [RUN_FAULTED] = 5, [RUN_ALONE] = 1, [RUN_REFUSED] = 4};
    if (argc < 2 || argc > 4) {
        fprintf(stderr, "usage: %s BUS [CYCLES [RATE_HZ]]\n", argv[0]);
        return 2;
    }
    uint32_t cycles = argc > 2 ? (uint32_t)strtoul(argv[2], NULL, 10) : RIG_CYCLES;
    double rate_hz = argc > 3 ? strtod(argv[3], NULL) : 0.0;
    period_ns = rate_hz > 0.0 ? (long)(1e9 / rate_hz) : 0;
    if (!open_bus(argv[1])) {
        fprintf(stderr, "%s: %s\n", argv[1], strerror(errno));
        return 4;
    }
    run_end end = run(cycles, rate_hz > 0.0);
    if (end == RUN_REFUSED) {
        fprintf(stderr, "not the bits of pcpc: compile with -ffp-contract=off and without -ffast-math\n");
    }
    return CODE[end];
}
