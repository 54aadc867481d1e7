/* One scan: drive after drive, settle, measure all pairs, write the rows that the table has, in its order.
 *
 * Nothing blocks longer than one measurement: eit_scan_step() returns EIT_AGAIN with the time of its next action, and
 * the caller does something else until then. The samples go straight into the frame's payload. */
#ifndef EIT_SCAN_H
#define EIT_SCAN_H

#include <stdbool.h>
#include <stdint.h>

#include "eit_config.h"
#include "eit_port.h"
#include "eit_status.h"

struct eit_scan {
    const struct eit_config *config;
    uint8_t *payload;    /* at least EIT_MAX_FRAME_BYTES */
    uint16_t drives;     /* those of this scan */
    uint8_t drive;       /* present one; 16 when the scan is complete */
    uint8_t rows;        /* written so far */
    uint8_t total_rows;
    bool settling;       /* the drive is on, the measurement is not due yet */
    uint32_t due_us;     /* when the next action is due */
};

/* Prepare a scan of these drives, which must have rows. */
void eit_scan_begin(struct eit_scan *scan, const struct eit_config *config, uint16_t drives, uint8_t *payload,
                    uint32_t now_us);

/* Do what is due. EIT_AGAIN: continue at scan->due_us. EIT_OK: samples and saturation bits are complete; the header is
 * the caller's. EIT_FRONT_END: the scan is lost. */
enum eit_status eit_scan_step(struct eit_scan *scan, const struct eit_port *port, uint32_t now_us);

#endif
