/* From reset to main() on a Cortex-M: vectors, memory, floating-point unit. */
#include <stddef.h>
#include <stdint.h>

extern uint32_t data_image, data_begin, data_end, bss_begin, bss_end, stack_top; /* linker script */
extern int main(void);
void reset_handler(void);
void tick_handler(void);
void uart_handler(void);
static void halt(void);

typedef void (*handler_t)(void);

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    handler_t exceptions[15];
    handler_t interrupts[1];
} VECTORS = {
    &stack_top,
    {reset_handler, halt, halt, halt, halt, halt, 0, 0, 0, 0, halt, halt, 0, halt, tick_handler},
    {uart_handler},
};

/* What compilers call by themselves, for copies of structs. */
void *memcpy(void *to, const void *from, size_t n);
void *memset(void *to, int value, size_t n);

void *memcpy(void *to, const void *from, size_t n)
{
    uint8_t *target = to;
    const uint8_t *source = from;
    for (size_t i = 0u; i < n; i++) {
        target[i] = source[i];
    }
    return to;
}

void *memset(void *to, int value, size_t n)
{
    uint8_t *target = to;
    for (size_t i = 0u; i < n; i++) {
        target[i] = (uint8_t)value;
    }
    return to;
}

static void halt(void)
{
    for (;;) {
    }
}

void reset_handler(void)
{
    volatile uint32_t *coprocessors = (volatile uint32_t *)0xE000ED88u;
    *coprocessors |= 0xF00000u; /* the floating-point unit is on */
    __asm__ volatile("dsb\n isb" ::: "memory");
    const uint32_t *from = &data_image;
    for (uint32_t *to = &data_begin; to < &data_end; to++) {
        *to = *from++;
    }
    for (uint32_t *to = &bss_begin; to < &bss_end; to++) {
        *to = 0u;
    }
    (void)main();
    halt();
}
