/* The device as an XCP slave on its bus (ASAM MCD-1 XCP 1.1 on CAN): `pcpc generate a2l RIG` describes it.

   Addresses are numbers of names, never memory: variable i is at 8 i .. 8 i + 7, a double. What is
   written is whole parameters, all of a DOWNLOAD or none, between two cycles; the event packet FD FE
   has the first cycle with them in 6 bytes. There is one DAQ list. No libc, no allocation. */
#ifndef XCP_H
#define XCP_H

#include "codec.h"

#define XCP_BLOCK 48u /* bytes of a DOWNLOAD in 8 frames */
#define XCP_ODTS 32u  /* frames that a cycle may send */

typedef struct {
    double *value; /* 0: the device does not hold it */
    double low; /* above `high`: nobody may write it */
    double high;
} xcp_variable;

typedef struct {
    const char *name;
    uint32_t every_n; /* cycles */
    uint8_t count; /* of 10^unit ns: its period */
    uint8_t unit;
} xcp_event;

/* Take a frame; false: it is not one of the master. */
bool xcp_frame(const frame_t *frame);

/* Before the blocks of cycle k: tell the master that what it wrote acts now. */
void xcp_written(uint32_t k);

/* Behind cycle k: send what the list wants of it. */
void xcp_measure(uint32_t k);

/* Behind the run: tell the master that the session has ended. */
void xcp_end(void);

#endif
