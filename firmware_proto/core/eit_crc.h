/* CRC-32C (Castagnoli), the check of packets and of stored configurations.
 *
 * Start with EIT_CRC_START, feed bytes in any number of pieces, and invert the result:
 *     uint32_t crc = eit_crc_update(EIT_CRC_START, data, length) ^ EIT_CRC_START;
 * eit_crc() does it in one call. 0xe3069283 for "123456789". A table of 16 words: two look-ups a byte. */
#ifndef EIT_CRC_H
#define EIT_CRC_H

#include <stddef.h>
#include <stdint.h>

#define EIT_CRC_START 0xffffffffu

uint32_t eit_crc_update(uint32_t state, const uint8_t *data, size_t length);
uint32_t eit_crc(const uint8_t *data, size_t length);

#endif
