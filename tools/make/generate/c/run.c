#include "run.h"

#include "device.h"
#include "port.h"
#if PCPC_FD
#include "rig.h"
#endif
#include "supervisor.h"
#if PCPC_XCP
#include "xcp.h"
#endif

#define GREET_MS 20u
#if PCPC_FD

/* 255, a length that no frame has, where a frame is of another kind than the DBC file says. */
static uint8_t length_of(const frame_t *frame)
{
    for (uint32_t row = 0u; row < RIG_HEARD; row++) {
        bool other = ((frame->flags ^ rig_heard[row].flags) & 5u) != 0u;
        if ((rig_heard[row].id == frame->id) && other) {
            return 255u;
        }
    }
    return frame->n;
}
#endif

static int32_t hear(uint32_t wait_ms)
{
    frame_t frame;
    int32_t came = port_receive(&frame, wait_ms);
    if (came > 0) {
#if PCPC_XCP
        (void)xcp_frame(&frame);
#endif
#if PCPC_FD
        device_frame(frame.id, frame.data, length_of(&frame));
#else
        device_frame(frame.id, frame.data, frame.n);
#endif
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
#if PCPC_XCP
    xcp_end();
#endif
    if (device_fault() == (uint32_t)FAULT_NONE) {
        return RUN_ENDED;
    }
    return (device_fault() == (uint32_t)FAULT_PEER_SILENT) ? RUN_ALONE : RUN_FAULTED;
}
