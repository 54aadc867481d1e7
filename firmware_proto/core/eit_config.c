#include "eit_config.h"

#include "eit_bytes.h"
#include "eit_crc.h"
#include "eit_message.h"

static const uint8_t factory_blob[EIT_CONFIG_BYTES] = {EIT_FACTORY_BLOB};

static bool gain_exists(uint16_t gain)
{
    static const uint16_t gains[] = EIT_GAINS;

    for (size_t i = 0; i < sizeof gains / sizeof gains[0]; i++) {
        if (gains[i] == gain) {
            return true;
        }
    }
    return false;
}

bool eit_config_is_full(const struct eit_config *config)
{
    return config->rows == EIT_FULL_ROWS;
}

/* Whole microseconds, rounded up, so that host and device agree to the last one. Capped: it must not wrap. */
uint32_t eit_config_scan_us(const struct eit_config *config, uint16_t drives)
{
    const uint64_t periods_us =
        ((uint64_t)config->averages * 1000000u + config->frequency_hz - 1u) / config->frequency_hz;
    const uint64_t total_us =
        EIT_SCAN_OVERHEAD_US +
        eit_drive_count(eit_config_is_full(config), drives) * ((uint64_t)config->settle_us + periods_us);

    return total_us > 0xffffffffu ? 0xffffffffu : (uint32_t)total_us;
}

/* A rate is reachable if rate * duration <= 1; in units of mHz and us that is 1e9. */
static bool rate_is_reachable(const struct eit_config *config, uint16_t drives, uint32_t rate_mHz)
{
    return (uint64_t)rate_mHz * eit_config_scan_us(config, drives) <= 1000000000u;
}

static enum eit_status check_values(const struct eit_config *c)
{
    const bool full = eit_config_is_full(c);

    if ((c->rows != EIT_ROWS && c->rows != EIT_FULL_ROWS) || c->sample_bytes < 2u || c->sample_bytes > 4u ||
        c->name[0] == 0 || !eit_is_text16(c->name) || c->averages == 0 || c->current_ua == 0 || c->rate_mHz == 0) {
        return EIT_VALUE;
    }
    if (eit_row_count(full, c->drives) == 0 || (c->idle_drives != 0) != (c->idle_rate_mHz != 0) ||
        (c->idle_drives != 0 && eit_row_count(full, c->idle_drives) == 0)) {
        return EIT_VALUE;
    }
    if (c->frequency_hz < EIT_MIN_FREQUENCY_HZ || c->frequency_hz > EIT_MAX_FREQUENCY_HZ ||
        c->current_ua > EIT_MAX_CURRENT_UA || c->settle_us < EIT_MIN_SETTLE_US || !gain_exists(c->gain)) {
        return EIT_VALUE;
    }
    if (!rate_is_reachable(c, c->drives, c->rate_mHz) ||
        (c->idle_drives != 0 && !rate_is_reachable(c, c->idle_drives, c->idle_rate_mHz))) {
        return EIT_RATE;
    }
    return EIT_OK;
}

/* The second half of the name is the skin's digest, if the flag says so. */
static bool read_name(const uint8_t *blob, struct eit_config *config)
{
    const size_t half = EIT_CONFIG_SKIN - EIT_CONFIG_NAME;
    uint8_t any = 0;

    config->has_skin = (blob[EIT_CONFIG_FLAGS] & EIT_CONFIG_FLAG_SKIN) != 0;
    eit_copy(config->name, blob + EIT_CONFIG_NAME, sizeof config->name);
    eit_copy(config->skin, blob + EIT_CONFIG_SKIN, sizeof config->skin);
    if (!config->has_skin) {
        return true;
    }
    for (size_t i = 0; i < sizeof config->skin; i++) {
        any |= config->skin[i];
        config->name[half + i] = 0;
    }
    return any != 0;
}

enum eit_status eit_config_read(const uint8_t *blob, size_t length, struct eit_config *config)
{
    static const uint8_t magic[4] = EIT_CONFIG_MAGIC_BYTES;

    if (length < 5u || !eit_same(blob, magic, sizeof magic)) {
        return EIT_DAMAGED;
    }
    if (blob[EIT_CONFIG_FORMAT] != EIT_CONFIG_FORMAT_KNOWN) {
        return EIT_VERSION;
    }
    if (length != EIT_CONFIG_BYTES || eit_crc(blob, EIT_CONFIG_CRC) != eit_get32(blob + EIT_CONFIG_CRC)) {
        return EIT_DAMAGED;
    }
    if (eit_get16(blob + EIT_CONFIG_SIZE) != EIT_CONFIG_BYTES || blob[EIT_CONFIG_FLAGS] > EIT_CONFIG_FLAG_SKIN) {
        return EIT_VALUE;
    }
    if (eit_get32(blob + EIT_CONFIG_HARDWARE_ID) != EIT_HARDWARE_ID) {
        return EIT_HARDWARE;
    }
    config->rows = blob[EIT_CONFIG_ROWS];
    config->sample_bytes = blob[EIT_CONFIG_SAMPLE_BYTES];
    config->drives = eit_get16(blob + EIT_CONFIG_DRIVES);
    config->idle_drives = eit_get16(blob + EIT_CONFIG_IDLE_DRIVES);
    config->settle_us = eit_get16(blob + EIT_CONFIG_SETTLE_US);
    config->averages = eit_get16(blob + EIT_CONFIG_AVERAGES);
    config->gain = eit_get16(blob + EIT_CONFIG_GAIN);
    config->frequency_hz = eit_get32(blob + EIT_CONFIG_FREQUENCY_HZ);
    config->current_ua = eit_get32(blob + EIT_CONFIG_CURRENT_UA);
    config->rate_mHz = eit_get32(blob + EIT_CONFIG_RATE_MHZ);
    config->idle_rate_mHz = eit_get32(blob + EIT_CONFIG_IDLE_RATE_MHZ);
    config->revision = eit_get32(blob + EIT_CONFIG_REVISION);
    config->digest = eit_get32(blob + EIT_CONFIG_CRC);
    return read_name(blob, config) ? check_values(config) : EIT_VALUE;
}

const uint8_t *eit_config_factory_blob(void)
{
    return factory_blob;
}

void eit_config_factory(struct eit_config *config)
{
    (void)eit_config_read(factory_blob, sizeof factory_blob, config); /* a test reads it and finds EIT_OK */
}
