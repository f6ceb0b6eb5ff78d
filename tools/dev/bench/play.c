/* A plain player in C: the yardstick of `pcpc play`.
 *
 *   play FILE BUS [PRIORITY]      FILE: as candump -L writes it, `(seconds) interface id#data`
 *                                 BUS: a SocketCAN interface, or GROUP:PORT for udp_multicast
 *
 * Absolute deadlines on CLOCK_MONOTONIC, one send a frame, no retry; the set-up is that of
 * drivers/machine/realtime.py, the datagram that of drivers/can/wire.py. Prints one JSON object; the timing
 * error of a frame is the time at which the bus had taken it minus its deadline, ns. By hand: a
 * program of its own, of which nothing here could be generated.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <fcntl.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define LEAD_NS 2000000
#define WITHIN_NS 200000
#define DEFAULT_GROUP "239.74.163.2"

struct recorded { int64_t stamp, error; struct can_frame frame; };

static void fail(const char *what)
{
    perror(what);
    exit(4);
}

static int64_t now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static int read_line(const char *line, struct recorded *out)
{
    char fraction[16], data[32];
    long long seconds;
    unsigned id;
    int at = 0;
    memset(out, 0, sizeof *out);
    data[0] = 0;
    if (sscanf(line, "(%lld.%15[0-9]) %*s %x#%n%31[0-9A-Fa-f]", &seconds, fraction, &id, &at, data) < 3)
        return 0;
    const char *hash = strchr(line, '#');
    const char *digits = hash;
    while (digits > line && digits[-1] != ' ')
        digits--;
    int64_t ns = 0;
    for (int i = 0; i < 9; i++)
        ns = ns * 10 + (i < (int)strlen(fraction) ? fraction[i] - '0' : 0);
    out->stamp = seconds * 1000000000LL + ns;
    out->frame.can_id = id | (hash - digits == 8 ? CAN_EFF_FLAG : 0);
    out->frame.can_dlc = strlen(data) / 2;
    for (int i = 0; i < out->frame.can_dlc && i < 8; i++)
        sscanf(data + 2 * i, "%2hhx", &out->frame.data[i]);
    return 1;
}

static size_t read_file(const char *path, struct recorded **out)
{
    FILE *file = fopen(path, "r");
    size_t n = 0, room = 1 << 16;
    char line[256];
    if (!file)
        fail(path);
    *out = malloc(room * sizeof **out);
    while (fgets(line, sizeof line, file)) {
        if (n == room)
            *out = realloc(*out, (room *= 2) * sizeof **out);
        n += read_line(line, *out + n);
    }
    fclose(file);
    return n;
}

static int open_can(const char *name)
{
    struct sockaddr_can address = {.can_family = AF_CAN};
    struct ifreq request = {0};
    int fd = socket(PF_CAN, SOCK_RAW, CAN_RAW);
    strncpy(request.ifr_name, name, IFNAMSIZ - 1);
    if (fd < 0 || ioctl(fd, SIOCGIFINDEX, &request))
        fail(name);
    address.can_ifindex = request.ifr_ifindex;
    setsockopt(fd, SOL_CAN_RAW, CAN_RAW_FILTER, NULL, 0);
    if (bind(fd, (struct sockaddr *)&address, sizeof address))
        fail(name);
    return fd;
}

static int open_udp(char *name)
{
    char *colon = strchr(name, ':');
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons(atoi(colon + 1))};
    struct in_addr loopback = {htonl(INADDR_LOOPBACK)};
    int fd = socket(AF_INET, SOCK_DGRAM, 0), one = 1;
    *colon = 0;
    if (strcmp(name, DEFAULT_GROUP) == 0) {
        to.sin_addr.s_addr = inet_addr("127.255.255.255");
        setsockopt(fd, SOL_SOCKET, SO_BROADCAST, &one, sizeof one);
    } else {
        to.sin_addr.s_addr = inet_addr(name);
        setsockopt(fd, IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof loopback);
    }
    if (fd < 0 || connect(fd, (struct sockaddr *)&to, sizeof to))
        fail(name);
    return fd;
}

static size_t put_key(uint8_t *packet, size_t at, const char *key)
{
    size_t n = strlen(key);
    packet[at++] = 0xA0 | n;
    memcpy(packet + at, key, n);
    return at + n;
}

static size_t put_false(uint8_t *packet, size_t at, const char *key)
{
    at = put_key(packet, at, key);
    packet[at] = 0xC2;
    return at + 1;
}

static size_t pack(const struct can_frame *frame, uint8_t *packet)
{
    uint32_t id = frame->can_id & CAN_EFF_MASK;
    size_t at = 0;
    packet[at++] = 0x8B; /* a map of eleven */
    at = put_key(packet, at, "timestamp");
    packet[at++] = 0xCB;
    memset(packet + at, 0, 8);
    at = put_key(packet, at + 8, "arbitration_id");
    packet[at++] = 0xCE;
    for (int shift = 24; shift >= 0; shift -= 8)
        packet[at++] = id >> shift;
    at = put_key(packet, at, "is_extended_id");
    packet[at++] = frame->can_id & CAN_EFF_FLAG ? 0xC3 : 0xC2;
    at = put_false(packet, at, "is_remote_frame");
    at = put_false(packet, at, "is_error_frame");
    at = put_key(packet, at, "channel");
    packet[at++] = 0xC0;
    at = put_key(packet, at, "dlc");
    packet[at++] = frame->can_dlc;
    at = put_key(packet, at, "data");
    packet[at++] = 0xC4;
    packet[at++] = frame->can_dlc;
    memcpy(packet + at, frame->data, frame->can_dlc);
    at = put_false(packet, at + frame->can_dlc, "is_fd");
    at = put_false(packet, at, "bitrate_switch");
    return put_false(packet, at, "error_state_indicator");
}

static int be_real_time(int priority)
{
    struct sched_param parameter = {.sched_priority = priority};
    struct rlimit memlock;
    int32_t latency_us = 0;
    int fd = open("/dev/cpu_dma_latency", O_WRONLY); /* held until the end */
    if (fd >= 0 && write(fd, &latency_us, sizeof latency_us) < 0)
        close(fd);
    getrlimit(RLIMIT_MEMLOCK, &memlock);
    if (memlock.rlim_cur == RLIM_INFINITY)
        mlockall(MCL_CURRENT | MCL_FUTURE);
    prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0);
    return sched_setscheduler(0, SCHED_FIFO, &parameter) == 0;
}

static long play(struct recorded *all, size_t n, int fd, int udp, int64_t start)
{
    uint8_t packet[512];
    long errors = 0;
    for (size_t i = 0; i < n; i++) {
        int64_t deadline = start + all[i].stamp - all[0].stamp;
        struct timespec until = {deadline / 1000000000, deadline % 1000000000};
        if (now() < deadline)
            while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL))
                ;
        const void *what = udp ? (void *)packet : (void *)&all[i].frame;
        size_t size = udp ? pack(&all[i].frame, packet) : sizeof all[i].frame;
        errors += send(fd, what, size, MSG_DONTWAIT) != (ssize_t)size;
        all[i].error = now() - deadline;
    }
    return errors;
}

static int by_size(const void *a, const void *b)
{
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

int main(int argc, char **argv)
{
    struct recorded *all;
    if (argc < 3) {
        fprintf(stderr, "play FILE BUS [PRIORITY]\n");
        return 2;
    }
    int udp = strchr(argv[2], ':') != NULL;
    size_t n = read_file(argv[1], &all), within = 0;
    if (n == 0) {
        fprintf(stderr, "%s: no frames\n", argv[1]);
        return 2;
    }
    int fd = udp ? open_udp(argv[2]) : open_can(argv[2]);
    int fifo = be_real_time(argc > 3 ? atoi(argv[3]) : 70);
    int64_t *errors = malloc(n * sizeof *errors);
    memset(errors, 0, n * sizeof *errors);
    long refused = play(all, n, fd, udp, now() + LEAD_NS);
    for (size_t i = 0; i < n; i++) {
        errors[i] = all[i].error;
        within += errors[i] <= WITHIN_NS;
    }
    double planned = all[n - 1].stamp - all[0].stamp;
    double total = planned > 0 ? 100.0 * (errors[n - 1] - errors[0]) / planned : 0.0;
    qsort(errors, n, sizeof *errors, by_size);
    printf("{\"frames\": %zu, \"send_errors\": %ld, \"timing_error_us\": {\"p50\": %.1f, "
           "\"p99\": %.1f, \"max\": %.1f}, \"within_200us_percent\": %.3f, "
           "\"total_error_percent\": %.6f, \"realtime\": %s}\n",
           n, refused, 1e-3 * errors[n / 2], 1e-3 * errors[n * 99 / 100], 1e-3 * errors[n - 1],
           100.0 * within / n, total, fifo ? "true" : "false");
    return refused ? 3 : 0;
}
