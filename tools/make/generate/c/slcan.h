/* slcan: CAN frames as text on a serial line, as adapters of LAWICEL speak it. This side is the adapter.

       tIIINDD..    a frame with an id of 11 bits, N data bytes     TIIIIIIIINDD..    of 29 bits
#if PCPC_FD
       dIIIN..      one of CAN FD; N: 9 to F are 12 to 64 bytes         DIIIIIIIIN..
       bIIIN..      that switches its bit rate                          BIIIIIIIIN..
#endif
       O            open: from now on frames pass                   C                 close
       S0 to S8     bit rate, of no meaning here

   Each ends with CR. A command is answered by CR, one that is not understood by BEL. A frame that
   the host sends is one that the device hears; it is not answered. */
#ifndef SLCAN_H
#define SLCAN_H

#include "codec.h"

#if PCPC_FD
#define SLCAN_LINE 139u /* D, id, length, 64 bytes, CR: the longest */
#else
#define SLCAN_LINE 27u /* T, id, length, 8 bytes, CR: the longest */
#endif

typedef struct {
    char line[SLCAN_LINE + 1u];
    uint32_t n;
    bool open;
    char reply; /* to be sent, 0: nothing */
} slcan_t;

/* Take a character; true: `frame` has come. */
bool slcan_take(slcan_t *slcan, char c, frame_t *frame);

/* Write a frame as a line; returns its length. */
uint32_t slcan_line(const frame_t *frame, char line[SLCAN_LINE + 1u]);

#endif
