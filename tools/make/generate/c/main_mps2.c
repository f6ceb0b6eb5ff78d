/* The device on Arm's MPS2 board, as QEMU has it: slcan on its first UART, a tick each period.

       sh qemu.sh m7

   The host opens the line (O), then the device greets. When the run is over QEMU ends, with the code
   of the program on Linux. -DDEVICE_CLOCKED: cycles begin by the board's own clock, not in lockstep. */
#include "port.h"
#include "rig.h"
#include "run.h"
#include "slcan.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART_DATA REGISTER(0x40004000u)
#define UART_STATE REGISTER(0x40004004u)
#define UART_CTRL REGISTER(0x40004008u)
#define UART_INTCLEAR REGISTER(0x4000400Cu)
#define UART_BAUDDIV REGISTER(0x40004010u)
#define TX_FULL 1u
#define RX_FULL 2u
#define SYSTICK_CTRL REGISTER(0xE000E010u)
#define SYSTICK_LOAD REGISTER(0xE000E014u)
#define SYSTICK_VALUE REGISTER(0xE000E018u)
#define NVIC_ENABLE REGISTER(0xE000E100u)
#define CLOCK_MHZ 25u
#define QUEUE 1024u /* characters; a power of two */

static volatile uint32_t ticks;
static volatile uint32_t put, taken;
static volatile char queue[QUEUE];
static slcan_t line;

void tick_handler(void);
void uart_handler(void);

void tick_handler(void)
{
    ticks += 1u;
}

void uart_handler(void)
{
    while ((UART_STATE & RX_FULL) != 0u) {
        char c = (char)(UART_DATA & 0xFFu);
        UART_INTCLEAR = 2u;
        if ((put - taken) < QUEUE) {
            queue[put % QUEUE] = c;
            put += 1u;
        }
    }
}

static void write_char(char c)
{
    while ((UART_STATE & TX_FULL) != 0u) {
    }
    UART_DATA = (uint32_t)(uint8_t)c;
}

void port_send(const frame_t *frame)
{
    char text[SLCAN_LINE + 1u];
    if (line.open) {
        uint32_t n = slcan_line(frame, text);
        for (uint32_t i = 0u; i < n; i++) {
            write_char(text[i]);
        }
    }
}

static bool take_char(char *c)
{
    if (taken == put) {
        return false;
    }
    *c = queue[taken % QUEUE];
    taken += 1u;
    return true;
}

int32_t port_receive(frame_t *frame, uint32_t wait_ms)
{
    uint32_t begin = ticks;
    uint32_t wait = (uint32_t)(((uint64_t)wait_ms * 1000000u) / RIG_PERIOD_NS);
    for (;;) {
        char c;
        while (take_char(&c)) {
            bool came = slcan_take(&line, c, frame);
            if (line.reply != '\0') {
                write_char(line.reply);
            }
            if (came) {
                return 1;
            }
        }
        if ((wait_ms == 0u) || ((ticks - begin) > wait)) {
            return 0;
        }
        __asm__ volatile("cpsid i");
        if (taken == put) {
            __asm__ volatile("wfi"); /* an interrupt that waits ends it, and is served behind it */
        }
        __asm__ volatile("cpsie i\n isb" ::: "memory");
    }
}

uint32_t port_sleep(void)
{
    static uint32_t last;
    uint32_t now = ticks;
    while (ticks == now) {
        __asm__ volatile("wfi");
    }
    uint32_t periods = ticks - last;
    last = ticks;
    return periods;
}

/* Semihosting: ends QEMU with a code. */
static void leave(uint32_t code)
{
    uint32_t block[2] = {0x20026u, code};
    register uint32_t operation __asm__("r0") = 0x20u;
    register uint32_t *about __asm__("r1") = block;
    __asm__ volatile("bkpt 0xAB" : "+r"(operation) : "r"(about) : "memory");
}

int main(void)
{
    static const uint32_t CODE[] = {0u, 5u, 1u, 4u};
#ifdef DEVICE_CLOCKED
    bool clocked = true;
#else
    bool clocked = false;
#endif
    UART_BAUDDIV = 16u;
    UART_CTRL = 1u | 2u | 8u; /* sends, receives, interrupts by what it receives */
    NVIC_ENABLE = 1u;
    SYSTICK_LOAD = ((RIG_PERIOD_NS / 1000u) * CLOCK_MHZ) - 1u;
    SYSTICK_VALUE = 0u;
    SYSTICK_CTRL = 7u;
    frame_t frame;
    while (!line.open) {
        (void)port_receive(&frame, 1000u);
    }
    leave(CODE[run(RIG_CYCLES, clocked)]);
    return 0;
}
