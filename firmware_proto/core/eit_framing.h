/* Packets on a byte stream: COBS(payload, CRC-32C) and 0x00 (SPEC.md, section 1).
 *
 * The sender stuffs a whole payload at once; the receiver takes the line byte by byte and needs memory only for the
 * longest payload that it wants to accept, plus the check. */
#ifndef EIT_FRAMING_H
#define EIT_FRAMING_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "eit_status.h"

#define EIT_CRC_BYTES 4u

/* Bytes that a packet takes at most, for a payload of n bytes. */
#define EIT_PACKET_BYTES(n) ((n) + EIT_CRC_BYTES + ((n) + EIT_CRC_BYTES + 253u) / 254u + 1u)

/* Write the packet of a payload. EIT_SPACE if it does not fit into capacity bytes; then nothing is to be sent.
 * EIT_LENGTH for an empty payload. */
enum eit_status eit_packet(const uint8_t *payload, size_t length, uint8_t *out, size_t capacity, size_t *written);

struct eit_deframer {
    uint8_t *buffer;          /* the caller's; holds payload and check while they arrive */
    size_t capacity;          /* longest payload + EIT_CRC_BYTES */
    size_t used;              /* decoded bytes so far */
    size_t seen;              /* bytes since the last delimiter */
    uint8_t left;             /* bytes of the current block still to come */
    bool zero_pending;        /* a zero belongs between this block and the next */
    bool flooded;             /* longer than the buffer: drop until the delimiter */
    bool synchronised;        /* a delimiter was seen: what fails from now on is corrupt */
    uint32_t packets;         /* intact so far */
    uint32_t corrupt;         /* pieces between delimiters that were no intact packet */
    uint32_t discarded_bytes; /* bytes of all that was dropped, delimiters not counted */
};

void eit_deframer_init(struct eit_deframer *deframer, uint8_t *buffer, size_t capacity);

/* Take one byte. EIT_OK: it completed a packet, whose payload of *length bytes lies at the start of the buffer until
 * the next byte is pushed. EIT_DAMAGED: it ended a piece that was dropped. EIT_AGAIN: otherwise. */
enum eit_status eit_deframer_push(struct eit_deframer *deframer, uint8_t byte, size_t *length);

#endif
