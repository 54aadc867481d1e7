/* Checks of whole messages, and the frame: packing sample by sample, and reading it back.
 *
 * eit_message_check() accepts exactly what the host's unpack() accepts (SPEC.md, sections 4 and 5); a test feeds both
 * the same bytes. Fields are then read with eit_get16/32 at the offsets of eit_wire.h. */
#ifndef EIT_MESSAGE_H
#define EIT_MESSAGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "eit_status.h"
#include "eit_wire.h"

#define EIT_NO_ROW 0xffu

/* What row `row` of a drive measures, below EIT_ROWS_PER_DRIVE; EIT_NO_ROW if a scan that is not full lacks the row. */
uint8_t eit_row_measure(bool full, uint8_t drive, uint8_t row);

/* Rows of a scan of these drives; 0 if none of them has a row. */
uint8_t eit_row_count(bool full, uint16_t drives);

/* Drives of these that have at least one row. */
uint8_t eit_drive_count(bool full, uint16_t drives);

/* Bytes of a frame's payload. */
size_t eit_frame_bytes(uint8_t rows, uint8_t sample_bytes);

struct eit_frame {
    uint8_t flags;
    uint8_t sample_bytes;
    uint8_t rows;
    uint32_t generation;
    uint32_t sequence;
    uint32_t device_us;
    uint16_t drives;
    uint16_t device_dropped;
};

/* Write the 20 bytes of a frame's header. */
void eit_frame_put_header(const struct eit_frame *frame, uint8_t *payload);

/* Write sample `row`, cut off at full scale. The value is left-justified: full scale is that of 32 bit. */
void eit_frame_put_sample(uint8_t *payload, uint8_t sample_bytes, uint8_t row, int32_t value);

/* Read a frame's header. EIT_TYPE, EIT_LENGTH or EIT_VALUE if the payload is not exactly one frame. */
enum eit_status eit_frame_get_header(const uint8_t *payload, size_t length, struct eit_frame *frame);

/* Read sample `row` of a frame that eit_frame_get_header accepted. */
int32_t eit_frame_get_sample(const uint8_t *payload, uint8_t sample_bytes, uint8_t row);

/* Whether 16 bytes are printable ASCII, padded with zeros. */
bool eit_is_text16(const uint8_t *at);

/* EIT_OK if the payload is exactly one message of this protocol, in either direction. */
enum eit_status eit_message_check(const uint8_t *payload, size_t length);

#endif
