/* A configuration: what the device scans, how, and how often (SPEC.md, section 6). */
#ifndef EIT_CONFIG_H
#define EIT_CONFIG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "eit_status.h"
#include "eit_wire.h"

struct eit_config {
    uint8_t rows;             /* 104: the table; 208: the full table */
    uint8_t sample_bytes;     /* 2, 3 or 4 */
    uint16_t drives;          /* bit k: drive k is scanned */
    uint16_t idle_drives;     /* the same in the idle mode; 0 if there is none */
    uint16_t settle_us;       /* wait after a change of drive */
    uint16_t averages;        /* whole periods averaged a drive */
    uint16_t gain;            /* linear */
    uint32_t frequency_hz;    /* of the drive current */
    uint32_t current_ua;      /* amplitude of the drive current */
    uint32_t rate_mHz; /* scans in 1000 s */
    uint32_t idle_rate_mHz;
    uint32_t revision;        /* the author's count */
    uint32_t digest;          /* the blob's CRC-32C */
    uint8_t name[16];         /* ASCII, padded with zeros */
    uint8_t skin[8];          /* digest of the skin that it is for, if one is stated */
    bool has_skin;
};

/* Read a blob. EIT_DAMAGED: not a configuration, or its check is wrong. EIT_VERSION: another format. EIT_HARDWARE: for
 * other electronics. EIT_VALUE: a value that means nothing or that these electronics do not have. EIT_RATE: they are
 * too slow for its rate. The configuration is only complete with EIT_OK. */
enum eit_status eit_config_read(const uint8_t *blob, size_t length, struct eit_config *config);

/* Whether the rows come from the full table. */
bool eit_config_is_full(const struct eit_config *config);

/* How long one scan of these drives takes, in us. */
uint32_t eit_config_scan_us(const struct eit_config *config, uint16_t drives);

/* The configuration built into the firmware. */
void eit_config_factory(struct eit_config *config);

/* Its blob, of EIT_CONFIG_BYTES bytes. */
const uint8_t *eit_config_factory_blob(void);

#endif
