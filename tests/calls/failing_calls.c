/* Calls of libc are counted, and one of them fails: preloaded by failing_calls.py.

   failing_calls.h, which that one writes, lists the functions. All take and return integers or pointers, so
   one prototype of six words fits them all. A process is named by prctl(PR_SET_NAME), its other
   threads have " thread" behind that, and what is forked is "child" until it has a name. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { NAME = 24, ROWS = 1024, SHORT = -1, FORWARD = -2, BACK = -3 };
enum { RETURNS_MINUS_1, RETURNS_NULL, RETURNS_ERRNO, CLOSES };
typedef long Call(long, long, long, long, long, long);

struct row {
    char process[NAME], call[NAME];
    long count;
};

static struct table {
    char process[NAME], call[NAME];
    long number, what, fired, used;
    struct row rows[ROWS];
} *table; /* in a file, for all processes of a command; NULL: nothing is counted */

static char name[NAME - 8];
static __thread struct row *known[256]; /* by function, of this thread */
static long jump_s[2];                  /* of CLOCK_REALTIME, CLOCK_MONOTONIC */

static void rename_process(const char *now)
{
    snprintf(name, sizeof name, "%s", now);
    memset(known, 0, sizeof known);
}

void calls_begin(const char *path, const char *process)
{
    rename_process(process);
    int file = syscall(SYS_openat, AT_FDCWD, path, O_RDWR | O_CLOEXEC, 0);
    void *found = mmap(0, sizeof *table, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    syscall(SYS_close, file);
    table = found == MAP_FAILED ? 0 : found;
}

__attribute__((constructor)) static void begin_in_a_new_program(void)
{
    if (getenv("PCPC_CALLS"))
        calls_begin(getenv("PCPC_CALLS"), "program");
}

static struct row *row_of(const char *call)
{
    char process[NAME];
    const char *thread = syscall(SYS_gettid) == syscall(SYS_getpid) ? "" : " thread";
    snprintf(process, NAME, "%s%s", name, thread);
    long used = __atomic_load_n(&table->used, __ATOMIC_ACQUIRE);
    for (struct row *one = table->rows; one < table->rows + used && used <= ROWS; one++)
        if (!strcmp(one->process, process) && !strcmp(one->call, call))
            return one;
    used = __atomic_fetch_add(&table->used, 1, __ATOMIC_ACQ_REL);
    if (used >= ROWS)
        abort();
    strcpy(table->rows[used].process, process);
    strcpy(table->rows[used].call, call);
    return table->rows + used;
}

/* Count a call; return how it fails, 0: it does not. */
static long failure(int function, const char *call)
{
    if (!table)
        return 0;
    int before = errno;
    struct row *row = known[function] ? known[function] : (known[function] = row_of(call));
    long number = __atomic_add_fetch(&row->count, 1, __ATOMIC_RELAXED);
    errno = before;
    if (number != table->number || strcmp(call, table->call) || strcmp(row->process, table->process))
        return 0;
    return __atomic_exchange_n(&table->fired, 1, __ATOMIC_RELAXED) ? 0 : table->what;
}

static long called(Call *real, long what, int kind, long a, long b, long c, long d, long e, long f)
{
    if (what > 0) {
        if (kind == CLOSES)
            real(a, b, c, d, e, f);
        errno = what;
        return kind == RETURNS_ERRNO ? what : kind == RETURNS_NULL ? 0 : -1;
    }
    return real(a, b, what == SHORT && c > 1 ? c / 2 : c, d, e, f);
}

#define REAL(function) \
    static Call *real; \
    if (!real) \
        real = (Call *)dlsym(RTLD_NEXT, #function);
#define PLACE(function) \
    Call calls_##function __asm__(#function); \
    long calls_##function(long a, long b, long c, long d, long e, long f)
#define CALL(function, kind) \
    PLACE(function) \
    { \
        REAL(function) \
        return called(real, failure(__COUNTER__, #function), kind, a, b, c, d, e, f); \
    }
#include "failing_calls.h"

PLACE(fork)
{
    REAL(fork)
    long pid = called(real, failure(__COUNTER__, "fork"), 0, a, b, c, d, e, f);
    if (!(int)pid)
        rename_process("child");
    return pid;
}

/* One that shares memory would come back into a frame that is gone. */
PLACE(vfork)
{
    REAL(fork)
    long pid = called(real, failure(__COUNTER__, "vfork"), 0, a, b, c, d, e, f);
    if (!(int)pid)
        rename_process("child");
    return pid;
}

PLACE(prctl)
{
    REAL(prctl)
    if (table && (int)a == PR_SET_NAME)
        rename_process((const char *)b + (strncmp((const char *)b, "pcpc ", 5) ? 0 : 5));
    return real(a, b, c, d, e, f);
}

PLACE(clock_gettime)
{
    REAL(clock_gettime)
    struct timespec *time = (struct timespec *)b;
    int monotonic = (int)a == CLOCK_MONOTONIC;
    if (monotonic || (int)a == CLOCK_REALTIME) {
        long what = failure(monotonic ? 254 : 255, monotonic ? "clock_monotonic" : "clock_real");
        jump_s[0] += what == FORWARD ? 10 : what == BACK ? -3600 : 0;
        jump_s[1] += what == FORWARD ? 10 : 0;
    }
    long done = real(a, b, c, d, e, f);
    time->tv_sec += monotonic || (int)a == CLOCK_REALTIME ? jump_s[monotonic] : 0;
    return done;
}

PLACE(clock_nanosleep)
{
    REAL(clock_nanosleep)
    struct timespec until = *(struct timespec *)c;
    if ((int)b == TIMER_ABSTIME && (int)a == CLOCK_MONOTONIC)
        until.tv_sec -= jump_s[1];
    long what = failure(__COUNTER__, "clock_nanosleep");
    return called(real, what, RETURNS_ERRNO, a, b, (long)&until, d, e, f);
}
