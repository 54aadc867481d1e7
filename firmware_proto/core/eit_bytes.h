/* Little-endian numbers in byte buffers, independent of the processor's order and of alignment. */
#ifndef EIT_BYTES_H
#define EIT_BYTES_H

#include <stddef.h>
#include <stdint.h>

static inline uint16_t eit_get16(const uint8_t *at)
{
    return (uint16_t)(at[0] | (uint16_t)(at[1] << 8));
}

static inline uint32_t eit_get32(const uint8_t *at)
{
    return (uint32_t)at[0] | ((uint32_t)at[1] << 8) | ((uint32_t)at[2] << 16) | ((uint32_t)at[3] << 24);
}

static inline void eit_put16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)(value & 0xffu);
    at[1] = (uint8_t)(value >> 8);
}

static inline void eit_put32(uint8_t *at, uint32_t value)
{
    at[0] = (uint8_t)(value & 0xffu);
    at[1] = (uint8_t)((value >> 8) & 0xffu);
    at[2] = (uint8_t)((value >> 16) & 0xffu);
    at[3] = (uint8_t)(value >> 24);
}

static inline void eit_copy(uint8_t *to, const uint8_t *from, size_t length)
{
    for (size_t i = 0; i < length; i++) {
        to[i] = from[i];
    }
}

static inline int eit_same(const uint8_t *a, const uint8_t *b, size_t length)
{
    for (size_t i = 0; i < length; i++) {
        if (a[i] != b[i]) {
            return 0;
        }
    }
    return 1;
}

#endif
