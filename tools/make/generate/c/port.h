/* What run.c needs of a machine. */
#ifndef PORT_H
#define PORT_H

#include "codec.h"

void port_send(const frame_t *frame);

/* Take a frame: 1 one came, -1 something that is no frame for us, 0 none within `wait_ms`. */
int32_t port_receive(frame_t *frame, uint32_t wait_ms);

/* On a clock: sleep until the next of its periods; how many are over since the last call, at least 1. */
uint32_t port_sleep(void);

#endif
