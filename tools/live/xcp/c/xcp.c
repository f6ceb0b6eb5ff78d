#include "xcp.h"

#include "port.h"
#include "rig.h"
#include "xcp_rig.h"

#if !defined(__BYTE_ORDER__) || (__BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__)
#error "values are sent as they lie in memory, which has to be little-endian"
#endif

#define PACKET 8u
#define ROOM 7u /* bytes behind a packet's code */
#define DONE 0x100u /* no error: the answer is sent */
#define SILENT 0x101u /* it was sent, or is due to the last packet of a block */
#define VARIABLES 0u /* address extensions */
#define TEXT 2u
#define STAMPED 0x10u /* of a list's mode */
#define NOT_OURS 0x23u /* alternating, stimulation, no number */

/* How far the list is built; what a command needs: a stage, that the list is there, or stands. */
enum { FREED, LISTED, WITH_ODTS, WITH_ENTRIES };
#define AT(stage) (1u << (uint32_t)(stage))
#define ANY 0x0Fu
#define LIST 0x0Eu
#define STILL 0x10u

static struct {
    bool connected;
    bool written; /* since the last cycle */
    uint32_t cycle;
    uint32_t extension; /* the memory transfer address */
    uint32_t address;
    const char *text;
    uint32_t text_n;
    uint32_t block_n; /* bytes of a DOWNLOAD, and those that are still to come */
    uint32_t left;
    uint8_t answer[PACKET];
} x;

static union {
    uint8_t bytes[XCP_BLOCK];
    double values[XCP_BLOCK / 8u];
} block;

static struct daq {
    uint32_t stage;
    uint32_t odts;
    uint32_t odt; /* what WRITE_DAQ fills */
    uint32_t next;
    uint32_t mode;
    uint32_t every_n;
    bool pointed;
    bool selected;
    bool running;
    uint32_t entries[XCP_ODTS];
    struct {
        uint32_t address;
        uint32_t size; /* 0: not yet written */
    } entry[XCP_ODTS][ROOM];
} daq;

static uint32_t number_at(const uint8_t *bytes, uint32_t n)
{
    uint32_t number = 0u;
    for (uint32_t i = n; i > 0u; i--) {
        number = (number << 8) | bytes[i - 1u];
    }
    return number;
}

static void put_number(uint8_t bytes[4], uint32_t number)
{
    for (uint32_t i = 0u; i < 4u; i++) {
        bytes[i] = (uint8_t)((number >> (8u * i)) & 0xFFu);
    }
}

static void put_stamp(uint8_t bytes[4])
{
    put_number(bytes, (uint32_t)((((uint64_t)x.cycle * RIG_PERIOD_NS) + 500u) / 1000u));
}

static void send(const uint8_t *bytes, uint32_t n)
{
    frame_t frame = {0};
    frame.id = XCP_SLAVE;
    frame.n = (uint8_t)n;
    for (uint32_t i = 0u; i < n; i++) {
        frame.data[i] = bytes[i];
    }
    port_send(&frame);
}

/* -------------------------------------------------------------------------------------- memory */

static uint32_t point(uint32_t extension, uint32_t address)
{
    x.extension = extension;
    x.address = address;
    return DONE;
}

/* Point to a text, which is uploaded then; its length. */
static uint8_t tell(const char *text)
{
    x.text = text;
    x.text_n = 0u;
    while (text[x.text_n] != '\0') {
        x.text_n++;
    }
    (void)point(TEXT, 0u);
    return (uint8_t)x.text_n;
}

/* The byte of a variable that is held. */
static uint8_t byte_of(uint32_t address)
{
    return ((const uint8_t *)xcp_table[address / 8u].value)[address % 8u];
}

/* Whether `n` bytes begin at the address; `size`: where all ends. */
static bool fits(uint32_t n, uint32_t size)
{
    return (n > 0u) && (x.address < size) && (n <= (size - x.address));
}

/* Send bytes in as many packets as it takes: slave block mode. */
static uint32_t upload(uint32_t n)
{
    bool text = x.extension == TEXT;
    if ((!text && (x.extension != VARIABLES)) || !fits(n, text ? x.text_n : (8u * XCP_VARIABLES))) {
        return ERR_OUT_OF_RANGE;
    }
    const uint32_t end = x.address + n;
    for (uint32_t at = x.address; !text && (at < end); at++) {
        if (xcp_table[at / 8u].value == 0) {
            return ERR_ACCESS_DENIED;
        }
    }
    while (x.address < end) {
        uint8_t packet[PACKET] = {0xFFu};
        uint32_t used = 1u;
        for (; (used < PACKET) && (x.address < end); x.address++) {
            packet[used] = text ? (uint8_t)x.text[x.address] : byte_of(x.address);
            used++;
        }
        send(packet, used);
    }
    return SILENT;
}

/* Write whole parameters, all of them or none. */
static uint32_t write_block(void)
{
    if (x.extension == TEXT) {
        return ERR_WRITE_PROTECTED;
    }
    if ((x.extension != VARIABLES) || !fits(x.block_n, 8u * XCP_VARIABLES) ||
        (((x.address | x.block_n) % 8u) != 0u)) {
        return ERR_OUT_OF_RANGE;
    }
    const xcp_variable *first = &xcp_table[x.address / 8u];
    for (uint32_t i = 0u; i < (x.block_n / 8u); i++) {
        if (first[i].value == 0) {
            return ERR_ACCESS_DENIED;
        }
        if (first[i].low > first[i].high) {
            return ERR_WRITE_PROTECTED;
        }
        if (!((block.values[i] >= first[i].low) && (block.values[i] <= first[i].high))) {
            return ERR_OUT_OF_RANGE;
        }
    }
    for (uint32_t i = 0u; i < (x.block_n / 8u); i++) {
        *first[i].value = block.values[i];
    }
    x.address += x.block_n;
    x.written = true;
    return DONE;
}

/* Take the next of a block's bytes: master block mode, only its last packet is answered. */
static uint32_t take(const uint8_t *c, uint32_t n)
{
    const uint32_t some = (x.left < (ROOM - 1u)) ? x.left : (ROOM - 1u);
    const uint32_t at = x.block_n - x.left;
    if (n < (some + 2u)) {
        x.left = 0u;
        return ERR_CMD_SYNTAX;
    }
    for (uint32_t i = 0u; i < some; i++) {
        block.bytes[at + i] = c[2u + i];
    }
    x.left -= some;
    return (x.left > 0u) ? SILENT : write_block();
}

static uint32_t download(const uint8_t *c, uint32_t n)
{
    if ((c[1] == 0u) || (c[1] > XCP_BLOCK)) {
        return ERR_OUT_OF_RANGE;
    }
    x.block_n = c[1];
    x.left = c[1];
    return take(c, n);
}

/* --------------------------------------------------------------------------------- measurement */

static uint32_t free_daq(void)
{
    daq = (struct daq){.every_n = 1u};
    return DONE;
}

static uint32_t alloc(uint32_t stage, uint32_t *count, uint32_t wanted, uint32_t most)
{
    if (wanted > most) {
        return ERR_MEMORY_OVERFLOW;
    }
    daq.stage = stage;
    *count = wanted;
    return DONE;
}

static uint32_t set_daq_ptr(uint32_t odt, uint32_t entry)
{
    if ((odt >= daq.odts) || (entry >= daq.entries[odt])) {
        return ERR_OUT_OF_RANGE;
    }
    daq.odt = odt;
    daq.next = entry;
    daq.pointed = true;
    return DONE;
}

static uint32_t write_daq(const uint8_t *c)
{
    const uint32_t size = c[2];
    const uint32_t address = number_at(&c[4], 4u);
    if (!daq.pointed) {
        return ERR_SEQUENCE;
    }
    if ((daq.next >= daq.entries[daq.odt]) || (c[1] != 0xFFu) || (c[3] != VARIABLES) || (size == 0u) ||
        (size > ROOM) || (((address % 8u) + size) > 8u) || ((address / 8u) >= XCP_VARIABLES)) {
        return ERR_OUT_OF_RANGE;
    }
    if (xcp_table[address / 8u].value == 0) {
        return ERR_ACCESS_DENIED;
    }
    daq.entry[daq.odt][daq.next].address = address;
    daq.entry[daq.odt][daq.next].size = size;
    daq.next++;
    return DONE;
}

static uint32_t set_daq_list_mode(uint32_t mode, uint32_t event, uint32_t prescaler)
{
    if ((mode & NOT_OURS) != 0u) {
        return ERR_MODE_NOT_VALID;
    }
    if ((event >= XCP_EVENTS) || (prescaler == 0u)) {
        return ERR_OUT_OF_RANGE;
    }
    daq.mode = mode & STAMPED;
    daq.every_n = xcp_events[event].every_n * prescaler;
    return DONE;
}

/* Start, stop or select the list. It starts if each of its packets is whole and fits into a frame. */
static uint32_t start_stop(bool starts, bool stops, bool selects)
{
    bool whole = daq.stage == (uint32_t)WITH_ENTRIES;
    for (uint32_t odt = 0u; odt < daq.odts; odt++) {
        uint32_t used = ((odt == 0u) && (daq.mode != 0u)) ? 5u : 1u;
        for (uint32_t i = 0u; i < daq.entries[odt]; i++) {
            whole = whole && (daq.entry[odt][i].size > 0u);
            used += daq.entry[odt][i].size;
        }
        whole = whole && (used <= PACKET);
    }
    if (starts && !whole) {
        return ERR_DAQ_CONFIG;
    }
    daq.running = starts || (daq.running && !stops);
    daq.selected = selects;
    return DONE;
}

static uint32_t get_daq_event_info(uint32_t event)
{
    if (event >= XCP_EVENTS) {
        return ERR_OUT_OF_RANGE;
    }
    x.answer[3] = tell(xcp_events[event].name);
    x.answer[4] = xcp_events[event].count;
    x.answer[5] = xcp_events[event].unit;
    return DONE;
}

/* ------------------------------------------------------------------------------------ commands */

static const struct {
    uint8_t code;
    uint8_t n; /* bytes; a frame of more is padded */
    uint8_t needs;
    uint8_t answer_n;
    uint8_t answer[PACKET];
} COMMANDS[] = {
    {CMD_CONNECT, 2u, ANY, 8u, {0xFFu, 5u, 0xC0u, PACKET, PACKET, 0u, 1u, 1u}},
    {CMD_DISCONNECT, 1u, ANY, 1u, {0xFFu}},
    {CMD_GET_STATUS, 1u, ANY, 6u, {0xFFu}},
    {CMD_SYNCH, 1u, ANY, 2u, {0xFEu, ERR_CMD_SYNCH}},
    {CMD_GET_COMM_MODE_INFO, 1u, ANY, 8u, {0xFFu, 0u, 1u, 0u, XCP_BLOCK / 6u, 0u, 0u, 0x10u}},
    {CMD_GET_ID, 2u, ANY, 8u, {0xFFu}},
    {CMD_SET_MTA, 8u, ANY, 1u, {0xFFu}},
    {CMD_UPLOAD, 2u, ANY, 0u, {0u}},
    {CMD_SHORT_UPLOAD, 8u, ANY, 0u, {0u}},
    {CMD_DOWNLOAD, 2u, ANY, 1u, {0xFFu}},
    {CMD_DOWNLOAD_NEXT, 2u, ANY, 1u, {0xFFu}},
    {CMD_FREE_DAQ, 1u, ANY, 1u, {0xFFu}},
    {CMD_ALLOC_DAQ, 4u, AT(FREED) | STILL, 1u, {0xFFu}},
    {CMD_ALLOC_ODT, 5u, AT(LISTED) | AT(WITH_ODTS) | STILL, 1u, {0xFFu}},
    {CMD_ALLOC_ODT_ENTRY, 6u, AT(WITH_ODTS) | AT(WITH_ENTRIES) | STILL, 1u, {0xFFu}},
    {CMD_SET_DAQ_PTR, 6u, LIST, 1u, {0xFFu}},
    {CMD_WRITE_DAQ, 8u, ANY | STILL, 1u, {0xFFu}},
    {CMD_SET_DAQ_LIST_MODE, 8u, LIST | STILL, 1u, {0xFFu}},
    {CMD_START_STOP_DAQ_LIST, 4u, LIST, 2u, {0xFFu}},
    {CMD_START_STOP_SYNCH, 2u, ANY, 1u, {0xFFu}},
    {CMD_GET_DAQ_CLOCK, 1u, ANY, 8u, {0xFFu}},
    {CMD_GET_DAQ_PROCESSOR_INFO, 1u, ANY, 8u, {0xFFu, 0x13u, 1u, 0u, XCP_EVENTS}},
    {CMD_GET_DAQ_RESOLUTION_INFO, 1u, ANY, 8u, {0xFFu, 1u, ROOM, 1u, 0u, 0x34u, 1u}},
    {CMD_GET_DAQ_EVENT_INFO, 4u, ANY, 7u, {0xFFu, 4u, 1u}},
};

/* Carry out a command of the right length at the right time; DONE: x.answer is complete. */
static uint32_t obey(const uint8_t *c, uint32_t n)
{
    static const char *const TEXTS[] = {XCP_NODE, XCP_RIG, XCP_RIG ".a2l"};
    switch (c[0]) {
    case CMD_CONNECT:
        x.connected = x.connected || (c[1] < 2u);
        (void)point(VARIABLES, 0u);
        return (c[1] < 2u) ? free_daq() : ERR_OUT_OF_RANGE;
    case CMD_DISCONNECT:
        x.connected = false;
        return free_daq();
    case CMD_GET_STATUS:
        x.answer[1] = daq.running ? 0x40u : 0u;
        return DONE;
    case CMD_GET_ID:
        x.answer[4] = tell((c[1] < 3u) ? TEXTS[c[1]] : "");
        return DONE;
    case CMD_SET_MTA:
        return point(c[3], number_at(&c[4], 4u));
    case CMD_UPLOAD:
        return upload(c[1]);
    case CMD_SHORT_UPLOAD:
        (void)point(c[3], number_at(&c[4], 4u));
        return (c[1] > ROOM) ? ERR_OUT_OF_RANGE : upload(c[1]);
    case CMD_DOWNLOAD:
        return download(c, n);
    case CMD_DOWNLOAD_NEXT:
        return ((x.left == 0u) || (c[1] != x.left)) ? ERR_SEQUENCE : take(c, n);
    case CMD_FREE_DAQ:
        return free_daq();
    case CMD_ALLOC_DAQ: /* one list, without a packet yet */
        return alloc(LISTED, &daq.odts, number_at(&c[2], 2u) - 1u, 0u);
    case CMD_ALLOC_ODT:
        return alloc(WITH_ODTS, &daq.odts, c[4], XCP_ODTS);
    case CMD_ALLOC_ODT_ENTRY:
        return (c[4] < daq.odts) ? alloc(WITH_ENTRIES, &daq.entries[c[4]], c[5], ROOM) : ERR_OUT_OF_RANGE;
    case CMD_SET_DAQ_PTR:
        return set_daq_ptr(c[4], c[5]);
    case CMD_WRITE_DAQ:
        return write_daq(c);
    case CMD_SET_DAQ_LIST_MODE:
        return set_daq_list_mode(c[1], number_at(&c[4], 2u), c[6]);
    case CMD_START_STOP_DAQ_LIST:
        return (c[1] > 2u) ? ERR_MODE_NOT_VALID
                           : start_stop(c[1] == 1u, c[1] == 0u, daq.selected || (c[1] == 2u));
    case CMD_START_STOP_SYNCH:
        return (c[1] > 2u) ? ERR_MODE_NOT_VALID
                           : start_stop((c[1] == 1u) && daq.selected,
                                        (c[1] == 0u) || ((c[1] == 2u) && daq.selected), false);
    case CMD_GET_DAQ_EVENT_INFO:
        return get_daq_event_info(number_at(&c[2], 2u));
    case CMD_GET_DAQ_CLOCK:
        put_stamp(&x.answer[4]);
        return DONE;
    default: /* the answer is always the same */
        return DONE;
    }
}

/* Judge a packet, carry it out and answer it. */
static void answer(const uint8_t *c, uint32_t n)
{
    const uint32_t rows = (uint32_t)(sizeof COMMANDS / sizeof COMMANDS[0]);
    uint32_t row = 0u;
    uint32_t found;
    while ((row < rows) && (COMMANDS[row].code != c[0])) {
        row++;
    }
    const uint32_t needs = (row < rows) ? COMMANDS[row].needs : 0u;
    if (row == rows) {
        found = ERR_CMD_UNKNOWN;
    } else if (n < COMMANDS[row].n) {
        found = ERR_CMD_SYNTAX;
    } else if (((needs & STILL) != 0u) && daq.running) {
        found = ERR_DAQ_ACTIVE;
    } else if ((needs & AT(daq.stage)) == 0u) {
        found = ((needs & LIST) == LIST) ? ERR_OUT_OF_RANGE : ERR_SEQUENCE;
    } else if (((needs & AT(FREED)) == 0u) && (number_at(&c[2], 2u) != 0u)) {
        found = ERR_OUT_OF_RANGE; /* another list */
    } else {
        for (uint32_t i = 0u; i < PACKET; i++) {
            x.answer[i] = COMMANDS[row].answer[i];
        }
        found = obey(c, n);
    }
    if (found == DONE) {
        send(x.answer, COMMANDS[row].answer_n);
    } else if (found != SILENT) {
        const uint8_t refused[2] = {0xFEu, (uint8_t)found};
        send(refused, 2u);
    } else {
        /* nothing now */
    }
}

bool xcp_frame(const frame_t *frame)
{
    const uint32_t n = (frame->n < PACKET) ? frame->n : PACKET;
    uint8_t c[PACKET] = {0u};
    for (uint32_t i = 0u; i < n; i++) {
        c[i] = frame->data[i];
    }
    const bool master = frame->id == XCP_MASTER;
    if (master && (c[0] != CMD_DOWNLOAD_NEXT)) {
        x.left = 0u;
    }
    if (master && (n > 0u) && (x.connected || (c[0] == CMD_CONNECT))) {
        answer(c, n);
    }
    return master;
}

void xcp_written(uint32_t k)
{
    uint8_t event[PACKET] = {0xFDu, 0xFEu};
    if (x.written && x.connected) {
        put_number(&event[2], k);
        send(event, PACKET);
    }
    x.written = false;
}

void xcp_measure(uint32_t k)
{
    x.cycle = k;
    for (uint32_t odt = 0u; daq.running && ((k % daq.every_n) == 0u) && (odt < daq.odts); odt++) {
        uint8_t packet[PACKET] = {(uint8_t)odt};
        uint32_t used = 1u;
        if ((odt == 0u) && (daq.mode != 0u)) {
            put_stamp(&packet[1]);
            used = 5u;
        }
        for (uint32_t i = 0u; i < daq.entries[odt]; i++) {
            for (uint32_t at = 0u; at < daq.entry[odt][i].size; at++) {
                packet[used] = byte_of(daq.entry[odt][i].address + at);
                used++;
            }
        }
        send(packet, used);
    }
}

void xcp_end(void)
{
    static const uint8_t event[2] = {0xFDu, 0x07u};
    if (x.connected) {
        send(event, 2u);
    }
}
