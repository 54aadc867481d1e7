/* The core on an emulated Cortex-M3 (QEMU's mps2-an385): UART0 is the line, timer 0 the clock, timer 1 the alarm,
 * PSRAM the storage and what the analogue front end (mps2_front_end.c) plays.
 *
 *     0x21000000  slot 0, 0x21001000  slot 1
 *     0x21080000  power[4]: cut at this change, changes so far, seed of the torn word, 0xdead once cut
 *     0x21100000  recording: "EITV", frames, volts a count at gain 1 (double), rate in mHz, 0, then frames of
 *                 208 int32 in full-table order; played by the clock from the first scan on, or frame by frame if
 *                 the rate is 0
 *
 * A host that maps the PSRAM's file can cut the power at a chosen change of storage: the firmware leaves that change
 * half done, says so in power[3] and stands still until it is killed. This is a board of its own right, so it has
 * globals; the core has none. */

#include "eit_device.h"
#include "mps2.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART_DATA REGISTER(0x40004000u)
#define UART_STATE REGISTER(0x40004004u)
#define UART_CONTROL REGISTER(0x40004008u)
#define UART_INTERRUPTS REGISTER(0x4000400cu)
#define UART_DIVIDER REGISTER(0x40004010u)
#define CLOCK_CONTROL REGISTER(0x40000000u)
#define CLOCK_VALUE REGISTER(0x40000004u)
#define CLOCK_RELOAD REGISTER(0x40000008u)
#define ALARM_CONTROL REGISTER(0x40001000u)
#define ALARM_VALUE REGISTER(0x40001004u)
#define ALARM_RELOAD REGISTER(0x40001008u)
#define ALARM_INTERRUPTS REGISTER(0x4000100cu)
#define NVIC_ENABLE REGISTER(0xe000e100u)
#define SYSTEM_RESET REGISTER(0xe000ed0cu)

#define TX_FULL 1u
#define RX_FULL 2u
#define TICKS_PER_US 25u
#define BAUD 921600u

#define SLOT_STRIDE 0x1000u
#define SLOT_WORDS (EIT_SLOT_BYTES / 4u)
#define POWER ((volatile uint32_t *)(MPS2_PSRAM + 0x80000u))
#define POWER_IS_CUT 0xdeadu

#define RING 8192u /* a power of two; 17 frames of 104 rows */

struct ring {
    volatile uint32_t put;
    volatile uint32_t taken;
    uint8_t bytes[RING];
};

static struct ring rx;
static struct ring tx;
static struct eit_device device;
static uint32_t clock_ticks; /* last value read */
static uint32_t clock_rest;  /* ticks that are no whole microsecond yet */
static uint32_t clock_us;    /* what timer 0 has counted */
static uint32_t settled_us;  /* when the drive has settled: the clock never shows less */

static uint32_t ring_used(const struct ring *ring)
{
    return ring->put - ring->taken;
}

uint32_t mps2_now_us(void *ctx)
{
    const uint32_t value = CLOCK_VALUE;
    const uint32_t ticks = clock_ticks - value + clock_rest; /* it counts down */

    (void)ctx;
    clock_ticks = value;
    clock_us += ticks / TICKS_PER_US;
    clock_rest = ticks % TICKS_PER_US;
    if ((int32_t)(settled_us - clock_us) > 0) {
        return settled_us;
    }
    settled_us = clock_us;
    return clock_us;
}

void mps2_settle_until(uint32_t moment_us)
{
    settled_us = moment_us;
}

/* Called with interrupts off, or from the interrupt. */
static void pump(void)
{
    while (ring_used(&tx) != 0 && (UART_STATE & TX_FULL) == 0) {
        UART_DATA = tx.bytes[tx.taken % RING];
        tx.taken++;
    }
}

static bool write_line(void *ctx, const uint8_t *packet, size_t length)
{
    (void)ctx;
    if (length > RING - ring_used(&tx)) {
        return false;
    }
    for (size_t i = 0; i < length; i++) {
        tx.bytes[tx.put % RING] = packet[i];
        tx.put++;
    }
    __asm volatile("cpsid i" ::: "memory");
    pump();
    __asm volatile("cpsie i" ::: "memory");
    return true;
}

static volatile uint32_t *slot_words(uint8_t slot)
{
    return (volatile uint32_t *)(MPS2_PSRAM + slot * SLOT_STRIDE);
}

static void storage_read(void *ctx, uint8_t slot, uint32_t offset, uint8_t *out, size_t length)
{
    const volatile uint8_t *from = (const volatile uint8_t *)slot_words(slot) + offset;

    (void)ctx;
    for (size_t i = 0; i < length; i++) {
        out[i] = from[i];
    }
}

static void stand_still(void)
{
    __asm volatile("cpsid i\n dsb" ::: "memory");
    POWER[3] = POWER_IS_CUT;
    for (;;) {
        __asm volatile("wfi");
    }
}

/* Change one word as far as the power lasts: `wanted` is what it should become. */
static void change(volatile uint32_t *word, uint32_t wanted)
{
    POWER[1] = POWER[1] + 1u;
    if (POWER[1] == POWER[0]) {
        const uint32_t before = *word;
        uint32_t state = POWER[2];
        uint32_t mask;

        for (unsigned i = 0; i < 8u && state > 1u; i++) {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
        }
        mask = state == 1u ? 0xffffffffu : state; /* seed 0: cut just before; 1: just after; else: torn */
        *word = (before & ~mask) | (wanted & mask);
        stand_still();
    }
    *word = wanted;
}

static enum eit_status storage_erase(void *ctx, uint8_t slot)
{
    (void)ctx;
    for (uint32_t i = 0; i < SLOT_WORDS; i++) {
        change(&slot_words(slot)[i], 0xffffffffu);
    }
    return EIT_OK;
}

static enum eit_status storage_program(void *ctx, uint8_t slot, uint32_t offset, uint32_t word)
{
    volatile uint32_t *at = &slot_words(slot)[offset / 4u];

    (void)ctx;
    change(at, *at & word);
    return EIT_OK;
}

static void restart(void *ctx)
{
    (void)ctx;
    SYSTEM_RESET = 0x05fa0004u;
    for (;;) {
    }
}

static void sleep_us(uint32_t duration_us)
{
    ALARM_CONTROL = 0;
    ALARM_INTERRUPTS = 1;
    ALARM_RELOAD = duration_us * TICKS_PER_US;
    ALARM_VALUE = duration_us * TICKS_PER_US;
    __asm volatile("cpsid i" ::: "memory"); /* an alarm that comes before wfi stays pending, and ends it */
    ALARM_CONTROL = 9;                      /* run, interrupt */
    if (ring_used(&rx) == 0) {
        __asm volatile("wfi");
    }
    __asm volatile("cpsie i" ::: "memory");
    ALARM_CONTROL = 0;
}

static void run(void)
{
    static const struct eit_port port = {
        NULL,       mps2_now_us,  write_line,           storage_read, storage_erase, storage_program,
        mps2_drive, mps2_measure, mps2_volts_per_count, restart,
    };
    static const struct eit_identity identity = {"QEMU-AN385", {1, 0, 0}, BAUD / 10u};

    UART_DIVIDER = 25000000u / BAUD;
    UART_CONTROL = 0xf; /* both directions, both interrupts */
    CLOCK_RELOAD = 0xffffffffu;
    CLOCK_VALUE = 0xffffffffu;
    CLOCK_CONTROL = 1;
    clock_ticks = 0xffffffffu;
    NVIC_ENABLE = 1u << 0 | 1u << 1 | 1u << 9;
    if (POWER[1] == 0xffffffffu) {
        POWER[1] = 0;
    }
    eit_device_boot(&device, &port, &identity);
    for (;;) {
        uint32_t idle_us;

        while (ring_used(&rx) != 0) {
            const uint8_t byte = rx.bytes[rx.taken % RING];

            rx.taken++;
            eit_device_receive(&device, &byte, 1);
        }
        eit_device_poll(&device);
        idle_us = eit_device_idle_us(&device);
        if (idle_us >= 20u) {
            sleep_us(idle_us);
        }
    }
}

static void on_receive(void)
{
    UART_INTERRUPTS = 2;
    while ((UART_STATE & RX_FULL) != 0) {
        const uint8_t byte = (uint8_t)(UART_DATA & 0xffu);

        if (ring_used(&rx) < RING) { /* a byte too many is lost; the packet then fails its check */
            rx.bytes[rx.put % RING] = byte;
            rx.put++;
        }
    }
}

static void on_transmit(void)
{
    UART_INTERRUPTS = 1;
    pump();
}

static void on_alarm(void)
{
    ALARM_INTERRUPTS = 1;
    ALARM_CONTROL = 0;
}

static void on_fault(void)
{
    restart(NULL);
}

extern uint32_t data_source[], data_start[], data_end[], bss_start[], bss_end[];

void stack_top(void); /* an address, not a function; the first vector is one */

__attribute__((noreturn)) void reset(void);
void reset(void)
{
    const uint32_t *from = data_source;

    /* cppcheck-suppress comparePointers ; the linker makes both ends of one section */
    for (uint32_t *to = data_start; to < data_end; to++, from++) {
        *to = *from;
    }
    /* cppcheck-suppress comparePointers ; likewise */
    for (uint32_t *to = bss_start; to < bss_end; to++) {
        *to = 0;
    }
    run();
    for (;;) {
    }
}

typedef void (*handler)(void);

__attribute__((section(".vectors"), used)) static const handler vectors[26] = {
    [0] = stack_top,
    [1] = reset,
    [2] = on_fault,  /* NMI */
    [3] = on_fault,  /* hard fault; the finer faults stay disabled and end here */
    [16] = on_receive,
    [17] = on_transmit,
    [25] = on_alarm, /* timer 1 */
};
