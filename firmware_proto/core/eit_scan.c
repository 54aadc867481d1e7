#include "eit_scan.h"

#include "eit_message.h"

static bool has_rows(const struct eit_scan *scan, uint8_t drive)
{
    return ((unsigned)scan->drives >> drive & 1u) != 0 &&
           eit_row_count(eit_config_is_full(scan->config), (uint16_t)(1u << drive)) != 0;
}

void eit_scan_begin(struct eit_scan *scan, const struct eit_config *config, uint16_t drives, uint8_t *payload,
                    uint32_t now_us)
{
    const bool full = eit_config_is_full(config);
    uint8_t *bits;

    scan->config = config;
    scan->payload = payload;
    scan->drives = drives;
    scan->drive = 0;
    scan->rows = 0;
    scan->total_rows = eit_row_count(full, drives);
    scan->settling = false;
    scan->due_us = now_us;
    bits = payload + EIT_FRAME_BYTES + (unsigned)scan->total_rows * config->sample_bytes;
    for (unsigned i = 0; i < (scan->total_rows + 7u) / 8u; i++) {
        bits[i] = 0;
    }
}

static void keep_row(struct eit_scan *scan, int32_t count, bool saturated)
{
    uint8_t *bits = scan->payload + EIT_FRAME_BYTES + (unsigned)scan->total_rows * scan->config->sample_bytes;

    eit_frame_put_sample(scan->payload, scan->config->sample_bytes, scan->rows, count);
    if (saturated) {
        bits[scan->rows / 8u] = (uint8_t)(bits[scan->rows / 8u] | (1u << (scan->rows % 8u)));
    }
    scan->rows++;
}

static enum eit_status measure(struct eit_scan *scan, const struct eit_port *port)
{
    const bool full = eit_config_is_full(scan->config);
    int32_t counts[EIT_PAIRS];
    uint16_t saturated = 0;
    const enum eit_status status = port->measure(port->ctx, scan->config, counts, &saturated);

    if (status != EIT_OK) {
        return status;
    }
    for (uint8_t row = 0; row < EIT_ROWS_PER_DRIVE; row++) {
        const uint8_t pair = eit_row_measure(full, scan->drive, row);

        if (pair != EIT_NO_ROW) {
            keep_row(scan, counts[pair], ((unsigned)saturated >> pair & 1u) != 0);
        }
    }
    return EIT_OK;
}

enum eit_status eit_scan_step(struct eit_scan *scan, const struct eit_port *port, uint32_t now_us)
{
    enum eit_status status;

    if ((int32_t)(now_us - scan->due_us) < 0) {
        return EIT_AGAIN;
    }
    if (scan->settling) {
        status = measure(scan, port);
        if (status != EIT_OK) {
            return status;
        }
        scan->settling = false;
        scan->drive++;
    }
    while (scan->drive < EIT_ELECTRODES && !has_rows(scan, scan->drive)) {
        scan->drive++;
    }
    if (scan->drive >= EIT_ELECTRODES) {
        return EIT_OK;
    }
    status = port->drive(port->ctx, scan->drive, scan->config);
    if (status != EIT_OK) {
        return status;
    }
    scan->settling = true;
    scan->due_us = now_us + scan->config->settle_us;
    return EIT_AGAIN;
}
