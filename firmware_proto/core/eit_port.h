/* The hardware, as callbacks. A board fills one of these and hands it to eit_device_boot(); the core never calls
 * anything else. Every callback gets `ctx`. None may call back into the core. */
#ifndef EIT_PORT_H
#define EIT_PORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "eit_config.h"
#include "eit_status.h"

#define EIT_PAIRS 16u /* U[m] - U[m + 1] for m = 0 .. 15 */

struct eit_port {
    void *ctx;

    /* Microseconds since some moment before boot, modulo 2^32. */
    uint32_t (*now_us)(void *ctx);

    /* Queue one packet for the line, whole or not at all; false if there is no room now. Must not block. */
    bool (*write)(void *ctx, const uint8_t *packet, size_t length);

    /* Copy bytes out of slot 0 or 1. Cannot fail. */
    void (*storage_read)(void *ctx, uint8_t slot, uint32_t offset, uint8_t *out, size_t length);

    /* Set every bit of a slot. EIT_OK or EIT_STORAGE. */
    enum eit_status (*storage_erase)(void *ctx, uint8_t slot);

    /* Clear the bits of the word at `offset`, a multiple of 4, that are 0 in `word`. EIT_OK or EIT_STORAGE. */
    enum eit_status (*storage_program)(void *ctx, uint8_t slot, uint32_t offset, uint32_t word);

    /* Send the current into electrode `drive` and out of the next one. EIT_OK or EIT_FRONT_END. */
    enum eit_status (*drive)(void *ctx, uint8_t drive, const struct eit_config *config);

    /* Measure all pairs at once under the present drive, averaged as the configuration says. counts[m] is
     * left-justified in 32 bit; bit m of *saturated tells that pair m was cut off in at least one sample. EIT_OK or
     * EIT_FRONT_END. */
    enum eit_status (*measure)(void *ctx, const struct eit_config *config, int32_t counts[EIT_PAIRS],
                               uint16_t *saturated);

    /* Volts of one step of a 32-bit count under this configuration. */
    double (*volts_per_count)(void *ctx, const struct eit_config *config);

    /* Boot again. May return, in which case the board boots soon after. */
    void (*restart)(void *ctx);
};

#endif
