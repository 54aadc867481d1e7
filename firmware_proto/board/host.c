#include "host.h"

#include <string.h>

#include "eit_bytes.h"
#include "eit_device.h"

#define SLOT_WORDS ((EIT_SLOT_BYTES + 3u) / 4u)
#define LINE_BYTES 65536u
#define MOST_OUTCOMES 32u

/* Both slots as they lie in storage. */
struct image {
    uint32_t slots[2][SLOT_WORDS];
};

struct eit_host {
    struct eit_device device;
    struct eit_port port;
    struct eit_identity identity;
    uint32_t now_us;
    struct image storage;
    uint32_t changes;
    uint32_t cut_at;
    uint32_t seed;
    int dead;
    uint32_t restarts;
    int wants_restart;
    int front_end_fails;
    uint8_t present_drive;
    int32_t counts[EIT_ELECTRODES][EIT_PAIRS];
    uint16_t saturated[EIT_ELECTRODES];
    size_t line_capacity;
    size_t sent;
    uint8_t line[LINE_BYTES];
    uint32_t watching; /* state of the noise that tears words; 0: nobody watches */
    uint32_t images;
    size_t outcome_count;
    struct eit_host_outcome outcomes[MOST_OUTCOMES];
};

static uint32_t now_us(void *ctx)
{
    return ((struct eit_host *)ctx)->now_us;
}

static bool write_line(void *ctx, const uint8_t *packet, size_t length)
{
    struct eit_host *host = ctx;

    if (host->dead || host->sent + length > host->line_capacity) {
        return false;
    }
    memcpy(host->line + host->sent, packet, length);
    host->sent += length;
    return true;
}

static uint32_t noise(uint32_t *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 17;
    *state ^= *state << 5;
    return *state;
}

/* Returns the bits of a change that happen: all of them, or some if this change is the one that the cut interrupts. */
static uint32_t happens(struct eit_host *host)
{
    uint32_t state = host->seed | 1u;

    host->changes++;
    if (host->cut_at == 0 || host->changes != host->cut_at) {
        return 0xffffffffu;
    }
    host->dead = 1;
    if (host->seed == 0) {
        return 0; /* cut just before */
    }
    if (host->seed == 1) {
        return 0xffffffffu; /* cut just after */
    }
    for (unsigned i = 0; i < 8u; i++) {
        (void)noise(&state);
    }
    return noise(&state);
}

static void image_read(const struct image *image, uint8_t slot, uint32_t offset, uint8_t *out, size_t length)
{
    for (size_t i = 0; i < length; i++) {
        const size_t at = offset + i;

        out[i] = (uint8_t)((image->slots[slot][at / 4u] >> (8u * (at % 4u))) & 0xffu);
    }
}

static void scratch_read(void *ctx, uint8_t slot, uint32_t offset, uint8_t *out, size_t length)
{
    image_read(ctx, slot, offset, out, length);
}

static enum eit_status scratch_erase(void *ctx, uint8_t slot)
{
    memset(((struct image *)ctx)->slots[slot], 0xff, sizeof((struct image *)ctx)->slots[slot]);
    return EIT_OK;
}

static enum eit_status scratch_program(void *ctx, uint8_t slot, uint32_t offset, uint32_t word)
{
    ((struct image *)ctx)->slots[slot][offset / 4u] &= word;
    return EIT_OK;
}

/* What a device with this storage runs, and what it runs once every trial is over. Changes the image. */
static void outcome_of(struct image *image, struct eit_host_outcome *out)
{
    struct eit_port port;
    struct eit_store store;
    struct eit_config config;

    memset(&port, 0, sizeof port);
    port.ctx = image;
    port.storage_read = scratch_read;
    port.storage_erase = scratch_erase;
    port.storage_program = scratch_program;
    eit_store_boot(&store, &port, &config);
    out->generation = store.generation;
    out->digest = config.digest;
    out->trial = store.trial ? 1u : 0u;
    for (unsigned i = 0; i < 2u && store.trial; i++) {
        eit_store_boot(&store, &port, &config);
    }
    out->settled_generation = store.generation;
    out->settled_digest = config.digest;
}

static void note_outcome(struct eit_host *host, const struct image *found)
{
    struct image image = *found;
    struct eit_host_outcome outcome;

    outcome_of(&image, &outcome);
    host->images++;
    for (size_t i = 0; i < host->outcome_count; i++) {
        if (memcmp(&host->outcomes[i], &outcome, sizeof outcome) == 0) {
            return;
        }
    }
    if (host->outcome_count < MOST_OUTCOMES) {
        host->outcomes[host->outcome_count] = outcome;
        host->outcome_count++;
    }
}

/* If somebody watches: what would boot if power failed within this change, and just after it. */
static void look(struct eit_host *host, uint8_t slot, size_t word, uint32_t after)
{
    struct image image;
    uint32_t mask;

    if (host->watching == 0) {
        return;
    }
    image = host->storage;
    mask = noise(&host->watching);
    image.slots[slot][word] = (image.slots[slot][word] & ~mask) | (after & mask);
    note_outcome(host, &image);
    image.slots[slot][word] = after;
    note_outcome(host, &image);
}

/* The same for an erase, whose words have no promised order: any one of them may be the first, and the power may fail
 * while all of them have some bits set. */
static void look_at_erase(struct eit_host *host, uint8_t slot)
{
    struct image image;

    if (host->watching == 0) {
        return;
    }
    for (size_t i = 0; i < SLOT_WORDS; i++) {
        image = host->storage;
        image.slots[slot][i] = 0xffffffffu;
        note_outcome(host, &image);
    }
    image = host->storage;
    for (size_t i = 0; i < SLOT_WORDS; i++) {
        image.slots[slot][i] |= noise(&host->watching);
    }
    note_outcome(host, &image);
}

static void storage_read(void *ctx, uint8_t slot, uint32_t offset, uint8_t *out, size_t length)
{
    image_read(&((const struct eit_host *)ctx)->storage, slot, offset, out, length);
}

/* No order of the words is promised by real storage: even seeds go up, odd ones down; with bit 1 of the seed set, the
 * words that the erase did not come to are half erased too. */
static enum eit_status storage_erase(void *ctx, uint8_t slot)
{
    struct eit_host *host = ctx;
    uint32_t *words = host->storage.slots[slot];
    uint32_t state = host->seed | 1u;

    look_at_erase(host, slot);
    for (size_t i = 0; i < SLOT_WORDS; i++) {
        const size_t word = host->seed % 2u == 0 ? i : SLOT_WORDS - 1u - i;

        if (!host->dead) {
            look(host, slot, word, 0xffffffffu);
            words[word] |= happens(host);
        } else if (host->seed > 1u && (host->seed & 2u) != 0) {
            words[word] |= noise(&state);
        }
    }
    return host->dead ? EIT_STORAGE : EIT_OK;
}

static enum eit_status storage_program(void *ctx, uint8_t slot, uint32_t offset, uint32_t word)
{
    struct eit_host *host = ctx;
    uint32_t *at = &host->storage.slots[slot][offset / 4u];

    if (host->dead) {
        return EIT_STORAGE;
    }
    look(host, slot, offset / 4u, *at & word);
    *at &= word | ~happens(host);
    return host->dead ? EIT_STORAGE : EIT_OK;
}

static enum eit_status drive(void *ctx, uint8_t number, const struct eit_config *config)
{
    struct eit_host *host = ctx;

    (void)config;
    host->present_drive = number;
    return host->front_end_fails ? EIT_FRONT_END : EIT_OK;
}

static enum eit_status measure(void *ctx, const struct eit_config *config, int32_t counts[EIT_PAIRS],
                               uint16_t *saturated)
{
    struct eit_host *host = ctx;

    (void)config;
    memcpy(counts, host->counts[host->present_drive], sizeof host->counts[0]);
    *saturated = host->saturated[host->present_drive];
    return host->front_end_fails ? EIT_FRONT_END : EIT_OK;
}

static double volts_per_count(void *ctx, const struct eit_config *config)
{
    (void)ctx;
    return 1.0 / 1073741824.0 / config->gain;
}

static void restart(void *ctx)
{
    ((struct eit_host *)ctx)->wants_restart = 1;
}

size_t eit_host_bytes(void)
{
    return sizeof(struct eit_host);
}

void eit_host_init(struct eit_host *host)
{
    static const uint8_t serial[16] = "HOST-0001";

    memset(host, 0, sizeof *host);
    memset(&host->storage, 0xff, sizeof host->storage);
    memcpy(host->identity.serial_number, serial, sizeof serial);
    host->identity.firmware_version[0] = 1;
    host->identity.line_bytes_per_s = 92160;
    host->line_capacity = LINE_BYTES;
    host->port.ctx = host;
    host->port.now_us = now_us;
    host->port.write = write_line;
    host->port.storage_read = storage_read;
    host->port.storage_erase = storage_erase;
    host->port.storage_program = storage_program;
    host->port.drive = drive;
    host->port.measure = measure;
    host->port.volts_per_count = volts_per_count;
    host->port.restart = restart;
    eit_host_boot(host);
}

/* The cut is over with the boot after it, unless the test arms another: `changes` has passed `cut_at`. */
void eit_host_boot(struct eit_host *host)
{
    host->dead = 0;
    host->wants_restart = 0;
    eit_device_boot(&host->device, &host->port, &host->identity);
}

void eit_host_receive(struct eit_host *host, const uint8_t *data, size_t length)
{
    if (!host->dead) {
        eit_device_receive(&host->device, data, length);
    }
}

void eit_host_run(struct eit_host *host, uint32_t duration_us, uint32_t step_us)
{
    uint32_t left_us = duration_us;

    for (;;) {
        uint32_t step = left_us < step_us ? left_us : step_us;

        if (host->dead) {
            return;
        }
        eit_device_poll(&host->device);
        if (host->wants_restart) {
            host->restarts++;
            eit_host_boot(host);
        }
        if (left_us == 0) {
            return;
        }
        host->now_us += step;
        left_us -= step;
    }
}

size_t eit_host_take(struct eit_host *host, uint8_t *out, size_t capacity)
{
    const size_t taken = host->sent < capacity ? host->sent : capacity;

    memcpy(out, host->line, taken);
    memmove(host->line, host->line + taken, host->sent - taken);
    host->sent -= taken;
    return taken;
}

void eit_host_set_line(struct eit_host *host, size_t capacity)
{
    host->line_capacity = capacity < LINE_BYTES ? capacity : LINE_BYTES;
}

void eit_host_cut(struct eit_host *host, uint32_t at, uint32_t seed)
{
    host->cut_at = at == 0 ? 0 : host->changes + at;
    host->seed = seed;
}

void eit_host_watch(struct eit_host *host, uint32_t seed)
{
    host->watching = seed;
    host->images = 0;
    host->outcome_count = 0;
}

size_t eit_host_outcomes(struct eit_host *host, struct eit_host_outcome *out, size_t capacity)
{
    const size_t taken = host->outcome_count < capacity ? host->outcome_count : capacity;

    memcpy(out, host->outcomes, taken * sizeof *out);
    host->outcome_count = 0;
    return taken;
}

uint32_t eit_host_images(const struct eit_host *host)
{
    return host->images;
}

void eit_host_outcome_of(const uint8_t slots[2][EIT_SLOT_BYTES], struct eit_host_outcome *out)
{
    struct image image;

    for (uint8_t slot = 0; slot < 2u; slot++) {
        for (size_t word = 0; word < SLOT_WORDS; word++) {
            image.slots[slot][word] = eit_get32(slots[slot] + 4u * word);
        }
    }
    outcome_of(&image, out);
}

uint32_t eit_host_changes(const struct eit_host *host)
{
    return host->changes;
}

int eit_host_is_dead(const struct eit_host *host)
{
    return host->dead;
}

uint32_t eit_host_restarts(const struct eit_host *host)
{
    return host->restarts;
}

void eit_host_set_counts(struct eit_host *host, const int32_t *counts, const uint16_t *saturated)
{
    memcpy(host->counts, counts, sizeof host->counts);
    memcpy(host->saturated, saturated, sizeof host->saturated);
}

void eit_host_set_front_end(struct eit_host *host, int fails)
{
    host->front_end_fails = fails;
}

void eit_host_set_clock(struct eit_host *host, uint32_t now)
{
    host->now_us = now;
}

size_t eit_host_feed(struct eit_deframer *deframer, const uint8_t *data, size_t length, uint8_t *out, size_t capacity)
{
    size_t used = 0;

    for (size_t i = 0; i < length; i++) {
        size_t payload;

        if (eit_deframer_push(deframer, data[i], &payload) == EIT_OK && payload + 2u <= capacity - used) {
            eit_put16(out + used, (uint16_t)payload);
            memcpy(out + used + 2u, deframer->buffer, payload);
            used += payload + 2u;
        }
    }
    return used;
}
