/* A bare loop in C: the yardstick of `pcpc jitter`.
 *
 *   wake INTERVAL_NS PERIODS PRIORITY CPU OUT       CPU: -1 for any
 *
 * Absolute deadlines on CLOCK_MONOTONIC; after a stall whole periods are skipped; the set-up is that
 * of drivers/machine/realtime.py. Writes how late each cycle woke to OUT, ns, as int64; prints 1 if
 * SCHED_FIFO was granted, else 0. SIGINT and SIGTERM end it early.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <sched.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

static volatile sig_atomic_t stopped;

static void stop(int number)
{
    (void)number;
    stopped = 1;
}

static int64_t now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static int set_up(int priority, int cpu)
{
    struct sched_param parameter = {.sched_priority = priority};
    struct sigaction action = {.sa_handler = stop};
    int32_t no_latency = 0;
    int latency = open("/dev/cpu_dma_latency", O_WRONLY); /* it holds while open */
    if (latency >= 0 && write(latency, &no_latency, sizeof no_latency) < 0)
        perror("/dev/cpu_dma_latency");
    mlockall(MCL_CURRENT | MCL_FUTURE);
    prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0);
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    int fifo = sched_setscheduler(0, SCHED_FIFO, &parameter) == 0;
    if (fifo && cpu >= 0) {
        cpu_set_t set;
        CPU_ZERO(&set);
        CPU_SET(cpu, &set);
        sched_setaffinity(0, sizeof set, &set);
    }
    return fifo;
}

int main(int argc, char **argv)
{
    if (argc != 6)
        return 2;
    int64_t interval = atoll(argv[1]), periods = atoll(argv[2]), n = 0;
    int64_t *late = malloc(periods * sizeof *late);
    if (!late)
        return 4;
    memset(late, 0, periods * sizeof *late);
    int fifo = set_up(atoi(argv[3]), atoi(argv[4]));
    int64_t deadline = (now() / interval + 2) * interval;
    for (int64_t k = 0; k < periods && !stopped; k++, deadline += interval) {
        struct timespec until = {deadline / 1000000000, deadline % 1000000000};
        if (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL))
            break;
        late[n++] = now() - deadline;
        int64_t behind = now() - deadline - interval;
        if (behind > 0) {
            k += behind / interval + 1;
            deadline += (behind / interval + 1) * interval;
        }
    }
    FILE *out = fopen(argv[5], "wb");
    if (!out || fwrite(late, sizeof *late, n, out) != (size_t)n || fclose(out)) {
        perror(argv[5]);
        return 4;
    }
    printf("%d\n", fifo);
    return 0;
}
