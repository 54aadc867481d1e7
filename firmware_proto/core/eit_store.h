/* Two slots for the configuration, so that a power cut at any moment leaves the old one or the new one (SPEC.md,
 * section 6).
 *
 *     0          64           68        72        76        80
 *     blob       generation   commit    attempt   confirm   revoked
 *
 * One word decides each step: commit makes a slot count, attempt says that its trial began, confirm ends the trial,
 * revoked takes it out. A word is programmed once after an erase; programming clears bits.
 *
 * Once a slot was confirmed, one is at every instant: the only confirmed slot is neither erased nor revoked. */
#ifndef EIT_STORE_H
#define EIT_STORE_H

#include <stdbool.h>
#include <stdint.h>

#include "eit_config.h"
#include "eit_port.h"
#include "eit_status.h"

#define EIT_SLOT_GENERATION 64u
#define EIT_SLOT_COMMIT 68u
#define EIT_SLOT_ATTEMPT 72u
#define EIT_SLOT_CONFIRM 76u
#define EIT_SLOT_REVOKED 80u
#define EIT_SLOT_BYTES 84u
#define EIT_NO_SLOT 2u

struct eit_store {
    const struct eit_port *port;
    uint8_t active;              /* slot that runs, or EIT_NO_SLOT for the built-in configuration */
    bool trial;                  /* the active one is not confirmed */
    bool gave_up;                /* this boot left an unconfirmed slot behind */
    uint32_t generation;         /* of the active one; 0 for the built-in configuration */
    uint32_t next_generation;    /* larger than any seen */
    uint32_t written;            /* bytes of the blob that is being written */
};

/* Choose the slot to run and read its configuration; falls back to the built-in one. Never fails. */
void eit_store_boot(struct eit_store *store, const struct eit_port *port, struct eit_config *config);

/* The slot that does not run. */
uint8_t eit_store_other(const struct eit_store *store);

/* Whether the other slot may be erased: a trial is not under way, and it is not the only confirmed one, as it is once
 * the active one was revoked. */
bool eit_store_may_begin(const struct eit_store *store);

/* Whether the active slot was revoked, so that the next boot runs the other one. */
bool eit_store_is_revoked(const struct eit_store *store);

/* Empty the other slot for a new blob; ask eit_store_may_begin() before. EIT_STORAGE if the storage did not obey. */
enum eit_status eit_store_begin(struct eit_store *store);

/* Append to the new blob. EIT_VALUE unless length is a multiple of 4 that fits; EIT_STORAGE if a word does not read
 * back. */
enum eit_status eit_store_write(struct eit_store *store, const uint8_t *data, uint32_t length);

/* Read the new blob back. Returns what eit_config_read() says about it. */
enum eit_status eit_store_verify(const struct eit_store *store, struct eit_config *config);

/* Make the new blob the one that the next boot tries. EIT_STORAGE if a word does not read back. */
enum eit_status eit_store_commit(struct eit_store *store, uint32_t digest, uint32_t *generation);

/* End the trial of the active slot. EIT_OK also if there is none. Not for one that was revoked. */
enum eit_status eit_store_confirm(struct eit_store *store);

/* Revoke the active slot. EIT_EMPTY if the other one is not confirmed; EIT_OK also if it is revoked already. */
enum eit_status eit_store_revoke(struct eit_store *store);

/* Read the configuration of a slot that is valid; EIT_EMPTY otherwise. */
enum eit_status eit_store_read(const struct eit_store *store, uint8_t slot, uint8_t blob[EIT_CONFIG_BYTES],
                               uint32_t *generation);

#endif
