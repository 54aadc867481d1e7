/* The core on the host, for tests by ctypes: a device whose line, clock, storage and front end are plain memory.
 *
 * The test owns the memory (eit_host_bytes() of it), moves the clock by hand, reads what was sent, and may cut the
 * power at the n-th change of storage: that change is then left half done, by a pattern that the test chooses, and
 * nothing works until eit_host_boot(). */
#ifndef EIT_HOST_H
#define EIT_HOST_H

#include <stddef.h>
#include <stdint.h>

#include "eit_store.h"

struct eit_deframer;
struct eit_host;

/* What a device runs after a boot, and what once every trial is over; generation 0 is the built-in configuration. */
struct eit_host_outcome {
    uint32_t generation;
    uint32_t digest;
    uint32_t trial; /* 1: it runs on trial */
    uint32_t settled_generation;
    uint32_t settled_digest;
};

size_t eit_host_bytes(void);

/* Fresh memory: both slots erased, clock at 0. Then boot. */
void eit_host_init(struct eit_host *host);
void eit_host_boot(struct eit_host *host);

/* Bytes to the device; call eit_host_run() to let it work. */
void eit_host_receive(struct eit_host *host, const uint8_t *data, size_t length);

/* Let time pass, in steps of at most step_us, polling the device at each. */
void eit_host_run(struct eit_host *host, uint32_t duration_us, uint32_t step_us);

/* Take what the device sent, up to capacity bytes; returns how many. */
size_t eit_host_take(struct eit_host *host, uint8_t *out, size_t capacity);

/* Bytes that the line holds before it refuses packets; at most 65536. */
void eit_host_set_line(struct eit_host *host, size_t capacity);

/* Cut the power at change `at` (1 is the next one; 0: never). `seed` chooses which bits of a torn word were changed,
 * the order in which an erase goes, and (bit 1) whether it is cut short in all words at once. */
void eit_host_cut(struct eit_host *host, uint32_t at, uint32_t seed);

/* From now on, find out at every change of storage what would boot if power failed within it (torn by `seed`) and
 * after it; 0: no more. Counting starts anew. */
void eit_host_watch(struct eit_host *host, uint32_t seed);

/* Take what was found since the last call, each once, at most capacity of it; returns how many. */
size_t eit_host_outcomes(struct eit_host *host, struct eit_host_outcome *out, size_t capacity);

/* How many states of storage were booted to find that out. */
uint32_t eit_host_images(const struct eit_host *host);

/* What a device would boot with this storage. */
void eit_host_outcome_of(const uint8_t slots[2][EIT_SLOT_BYTES], struct eit_host_outcome *out);

/* Changes of storage since eit_host_init(): one a programmed word, one a word of an erase. */
uint32_t eit_host_changes(const struct eit_host *host);

/* 1 after the power was cut, until eit_host_boot(). */
int eit_host_is_dead(const struct eit_host *host);

/* Times that the device asked to be restarted; each has booted it. */
uint32_t eit_host_restarts(const struct eit_host *host);

/* Set the 16 left-justified counts of each of the 16 drives, and which were cut off (bit m of saturated[k]). */
void eit_host_set_counts(struct eit_host *host, const int32_t *counts, const uint16_t *saturated);

/* Make the front end fail from now on (1) or work again (0). */
void eit_host_set_front_end(struct eit_host *host, int fails);

void eit_host_set_clock(struct eit_host *host, uint32_t now_us);

/* Push bytes through a deframer; writes each payload as u16 length and bytes. Returns the bytes written; payloads
 * that do not fit into capacity are left out. */
size_t eit_host_feed(struct eit_deframer *deframer, const uint8_t *data, size_t length, uint8_t *out, size_t capacity);

#endif
