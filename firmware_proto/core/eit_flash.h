/* Requests that change the stored configuration: lock, session, chunks, commit, trial, rollback (SPEC.md, section 6).
 * */
#ifndef EIT_FLASH_H
#define EIT_FLASH_H

#include <stddef.h>
#include <stdint.h>

#include "eit_device.h"

/* Code and detail of an ACK. */
struct eit_answer {
    uint8_t code;
    uint32_t detail;
};

static inline struct eit_answer eit_answer(uint8_t code, uint32_t detail)
{
    const struct eit_answer made = {code, detail};

    return made;
}

/* What a status of the store or of a configuration is on the wire. */
uint8_t eit_flash_code(enum eit_status status);

/* Milliseconds until the lock expires; 0 if the lock is free. */
uint32_t eit_flash_lock_ms(struct eit_device *device, uint32_t now_us);

/* Each takes a payload that eit_message_check() accepted. */
struct eit_answer eit_flash_begin(struct eit_device *device, const uint8_t *payload, uint32_t now_us);
struct eit_answer eit_flash_confirm(struct eit_device *device, const uint8_t *payload);
struct eit_answer eit_flash_rollback(struct eit_device *device, const uint8_t *payload, uint32_t now_us);

/* CONFIG_WRITE, VERIFY, COMMIT and ABORT, which need an open session. */
struct eit_answer eit_flash_in_session(struct eit_device *device, const uint8_t *payload, size_t length,
                                       uint32_t now_us);

#endif
