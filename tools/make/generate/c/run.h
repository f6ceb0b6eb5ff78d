#ifndef RUN_H
#define RUN_H

#include <stdbool.h>
#include <stdint.h>

typedef enum { RUN_ENDED, RUN_FAULTED, RUN_ALONE, RUN_REFUSED } run_end;

/* A run from the first greeting to its end; `clocked`: by port_sleep(), else in lockstep. */
run_end run(uint32_t cycles, bool clocked);

#endif
