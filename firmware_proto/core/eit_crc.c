#include "eit_crc.h"

/* Remainders of the sixteen low nibbles under the reflected polynomial 0x82f63b78. */
static const uint32_t nibble_table[16] = {
    0x00000000u, 0x105ec76fu, 0x20bd8edeu, 0x30e349b1u, 0x417b1dbcu, 0x5125dad3u, 0x61c69362u, 0x7198540du,
    0x82f63b78u, 0x92a8fc17u, 0xa24bb5a6u, 0xb21572c9u, 0xc38d26c4u, 0xd3d3e1abu, 0xe330a81au, 0xf36e6f75u,
};

uint32_t eit_crc_update(uint32_t state, const uint8_t *data, size_t length)
{
    for (size_t i = 0; i < length; i++) {
        state ^= data[i];
        state = (state >> 4) ^ nibble_table[state & 15u];
        state = (state >> 4) ^ nibble_table[state & 15u];
    }
    return state;
}

uint32_t eit_crc(const uint8_t *data, size_t length)
{
    return eit_crc_update(EIT_CRC_START, data, length) ^ EIT_CRC_START;
}
