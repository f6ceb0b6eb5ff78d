/* The device in a rig's loop: what it hears, its supervisor, what it sends (pcpc, docs/device.md).

       INIT   waiting for the plant                 READY  the plant is there
       RUN    the loop is closed                    HOLD   a cycle ran on the last valid sample
       FAULT  commands ramp to their safe values    STOP   commands are safe, the device ends

   Which follows which, and the faults: supervisor.h.

   A run, for who drives it (run.c does):

       device_init(cycles, send);
       until device_met():    device_greet() every 20 ms, device_frame() for what comes
       device_sync();
       until device_over():   device_frame() until device_ready(), or in time; device_cycle(1)

   No libc, no allocation, no I/O but `send`. One device a program. */
#ifndef DEVICE_H
#define DEVICE_H

#include "codec.h"

typedef void (*device_send)(const frame_t *frame);

/* Begin: `cycles` as long as the run is, 0 for one that only the plant ends. False: this program was
   not compiled to give the bits of pcpc (-ffp-contract=off); it must not run. */
bool device_init(uint32_t cycles, device_send send);

/* Say that the device is there, as long as it has not met the plant. */
void device_greet(void);

/* Whether the plant was heard. */
bool device_met(void);

/* Ask for the plant's sample of t = 0, once it was heard. */
void device_sync(void);

/* Take a frame that came; any may be given, also those of others. */
void device_frame(uint32_t id, const uint8_t data[ROOM], uint8_t n);

/* Without a clock: whether all is there that a cycle begins with. */
bool device_ready(void);

/* One cycle, `periods` after the one before (more than 1: cycles were skipped). */
void device_cycle(uint32_t periods);

/* The plant sent nothing for too long: the device sends what is safe, and ends. */
void device_alone(void);

/* Whether the run is over: by its length, by a fault, or by the plant's last heartbeat. */
bool device_over(void);

/* Why the device faulted, 0: it did not; see device.c. */
uint32_t device_fault(void);

#endif
