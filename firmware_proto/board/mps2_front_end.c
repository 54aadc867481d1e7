/* The analogue front end of the emulated board: it plays the voltages that its storage file holds, by the clock from
 * the first scan on, or frame by frame. Without a recording it plays a pattern that names drive, pair and scan. */

#include <string.h>

#include "eit_bytes.h"
#include "mps2.h"

#define RECORDING ((const uint8_t *)(MPS2_PSRAM + 0x100000u))
#define RECORDING_HEAD 24u
#define RECORDING_MAX_FRAMES ((0xf00000u - RECORDING_HEAD) / (4u * EIT_FULL_ROWS))

static uint8_t present_drive;
static uint32_t scans;       /* begun since boot */
static uint32_t scan_us;     /* when the present one began */
static uint64_t playing_us;  /* since the first one began */

static uint32_t recorded_frames(void)
{
    static const uint8_t magic[4] = {'E', 'I', 'T', 'V'};
    const uint32_t frames = eit_get32(RECORDING + 4);

    return eit_same(RECORDING, magic, sizeof magic) && frames <= RECORDING_MAX_FRAMES ? frames : 0;
}

enum eit_status mps2_drive(void *ctx, uint8_t number, const struct eit_config *config)
{
    /* Emulated electronics settle at once, so the clock jumps ahead and waits for timer 0 at the end of the scan.
     * Fourteen alarms a frame would measure the scheduler of the machine below. */
    const uint32_t now = mps2_now_us(ctx);

    mps2_settle_until(now + config->settle_us);
    if (number <= present_drive) {
        playing_us += scans == 0 ? 0 : now - scan_us;
        scan_us = now;
        scans++;
    }
    present_drive = number;
    return EIT_OK;
}

/* Which frame of a recording is due. */
static uint32_t due_frame(uint32_t frames)
{
    const uint32_t rate_mHz = eit_get32(RECORDING + 16);

    if (rate_mHz == 0) {
        return (scans - 1u) % frames;
    }
    return (uint32_t)(playing_us * rate_mHz / 1000000000u % frames);
}

static int32_t played(uint32_t frames, uint32_t due, uint32_t pair)
{
    const uint32_t row = (pair - present_drive - 2u) % EIT_ELECTRODES;

    if (row >= 13u) {
        return 0; /* shares an electrode with the drive: not in the table */
    }
    if (frames == 0) {
        return (int32_t)(((present_drive * 16u + pair + 1u) << 16) + (scans & 0xffu) * 256u);
    }
    return (int32_t)eit_get32(RECORDING + RECORDING_HEAD +
                              4u * (due * EIT_FULL_ROWS + present_drive * 13u + row));
}

enum eit_status mps2_measure(void *ctx, const struct eit_config *config, int32_t counts[EIT_PAIRS],
                             uint16_t *saturated)
{
    const uint32_t frames = recorded_frames();
    const uint32_t due = frames == 0 ? 0 : due_frame(frames);

    (void)ctx;
    *saturated = 0;
    for (uint32_t pair = 0; pair < EIT_PAIRS; pair++) {
        const int64_t amplified = (int64_t)played(frames, due, pair) * config->gain;

        if (amplified > INT32_MAX || amplified < -INT32_MAX) {
            *saturated = (uint16_t)(*saturated | (1u << pair));
            counts[pair] = amplified > 0 ? INT32_MAX : -INT32_MAX;
        } else {
            counts[pair] = (int32_t)amplified;
        }
    }
    return EIT_OK;
}

double mps2_volts_per_count(void *ctx, const struct eit_config *config)
{
    double volts = 1.0 / 1073741824.0;

    (void)ctx;
    if (recorded_frames() != 0) {
        memcpy(&volts, RECORDING + 8, sizeof volts);
    }
    return volts / config->gain;
}
