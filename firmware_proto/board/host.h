/* The core on the host, for tests by ctypes: a device whose line, clock, storage and front end are plain memory.
 *
 * The test owns the memory (eit_host_bytes() of it), moves the clock by hand, reads what was sent, and may cut the
 * power at the n-th change of storage: that change is then left half done, by a pattern that the test chooses, and
 * nothing works until eit_host_boot(). */
#ifndef EIT_HOST_H
#define EIT_HOST_H

#include <stddef.h>
#include <stdint.h>

struct eit_deframer;
struct eit_host;

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

/* Cut the power at change `at` (1 is the next one; 0: never). `seed` chooses which bits of a torn word were changed. */
void eit_host_cut(struct eit_host *host, uint32_t at, uint32_t seed);

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
