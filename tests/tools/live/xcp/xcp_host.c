/* xcp.c alone on packets from stdin: a byte of length, the packet. To stdout, of each: "=" and the
   packets that were sent, each behind its length; behind every third a cycle of a list, "*". */
#include <stdio.h>
#include <string.h>

#include "port.h"
#include "rig.h"
#include "xcp_rig.h"

static double table[5] = {0.5, -1.25, 110.0, 60.0, 7.0};

const xcp_variable xcp_table[XCP_VARIABLES] = {
    {&table[0], 1.0, 0.0}, {&table[1], 1.0, 0.0}, {&table[2], 0.0, 1000.0}, {&table[3], 0.0, 1000.0}, {0, 0.0, 1.0},
};
const xcp_event xcp_events[XCP_EVENTS] = {{"cycle", 1u, 1u, 6u}, {"cycle_10", 10u, 1u, 7u}, {"cycle_100", 100u, 1u, 8u}};

void port_send(const frame_t *frame)
{
    if (frame->id == XCP_SLAVE) {
        putchar(frame->n);
        fwrite(frame->data, 1, frame->n, stdout);
    }
}

int main(void)
{
    int n;
    for (uint32_t k = 0u; (n = getchar()) != EOF; k++) {
        frame_t frame = {XCP_MASTER, (uint8_t)n, {0}};
        uint8_t packet[255];
        if (fread(packet, 1, (size_t)n, stdin) != (size_t)n) {
            return 2;
        }
        memcpy(frame.data, packet, n < 8 ? (size_t)n : 8u);
        putchar('=');
        (void)xcp_frame(&frame);
        if (k % 3u == 0u) {
            putchar('*');
            xcp_written(k);
            xcp_measure(k);
        }
    }
    putchar('!');
    fwrite(table, sizeof table, 1, stdout);
    return 0;
}
