#include "run.h"

#include "device.h"
#include "port.h"
#include "supervisor.h"

#define GREET_MS 20u

static int32_t hear(uint32_t wait_ms)
{
    frame_t frame;
    int32_t came = port_receive(&frame, wait_ms);
    if (came > 0) {
        device_frame(frame.id, frame.data, frame.n);
    }
    return came;
}

/* Greet until the plant is there, then ask for the sample of t = 0. A plant answers a greeting, and
   with several an answer to each answer would be a flood. */
static void meet(void)
{
    device_greet();
    while (!device_met()) {
        if (hear(GREET_MS) == 0) {
            device_greet();
        }
    }
    device_sync();
}

/* Until all is there that a cycle begins with; false: the plant has ended, or fell silent. */
static bool gather(void)
{
    while (!device_ready() && !device_over()) {
        if (hear(PATIENCE_MS) == 0) {
            device_alone();
        }
    }
    return !device_over();
}

/* On a clock: sleep, then take all that is there. */
static uint32_t wake(void)
{
    uint32_t periods = port_sleep();
    while (hear(0u) != 0) {
    }
    return periods;
}

run_end run(uint32_t cycles, bool clocked)
{
    bool begun = false;
    if (!device_init(cycles, port_send)) {
        return RUN_REFUSED;
    }
    meet();
    while (!device_over()) {
        uint32_t periods = 1u;
        if (clocked && begun) {
            periods = wake();
        } else if (!gather()) {
            break;
        } else if (clocked) {
            (void)port_sleep();
        } else {
            /* as soon as all is there */
        }
        begun = true;
        if (!device_over()) {
            device_cycle(periods);
        }
    }
    if (device_fault() == (uint32_t)FAULT_NONE) {
        return RUN_ENDED;
    }
    return (device_fault() == (uint32_t)FAULT_PEER_SILENT) ? RUN_ALONE : RUN_FAULTED;
}
