/* The closed loop that `pcpc generate c RIG --check` compiles, as often as wanted in one process. By
 * hand: the program runs once and prints. Both nodes begin anew; returns its digest, 0: refused. */
#include <string.h>

#define main run_once
#include "closed_loop.inc"
#undef main

#define BASIS 14695981039346656037u
#define PRIME 1099511628211u

uint64_t run(uint32_t cycles);
uint64_t run(uint32_t cycles)
{
    memset(&executive_in, 0, sizeof executive_in);
    memset(&plant_in, 0, sizeof plant_in);
    if ((executive_rig_init(&executive_node) | plant_rig_init(&plant_node)) != 0)
        return 0;
    executive_digest = plant_digest = BASIS;
    plant_cycle(0);
    for (uint32_t k = 0; k < cycles; k++) {
        executive_cycle(k);
        plant_cycle(k + 1);
    }
    return ((executive_digest * PRIME) ^ plant_digest) * PRIME;
}
