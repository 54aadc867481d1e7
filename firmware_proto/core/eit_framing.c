#include "eit_framing.h"

#include "eit_bytes.h"
#include "eit_crc.h"

/* COBS encoder state: `code` is where the code byte of the open block goes, `run` its bytes so far. */
struct stuffer {
    uint8_t *out;
    size_t capacity;
    size_t at;
    size_t code;
    uint8_t run;
    bool full;
};

static void emit(struct stuffer *s, uint8_t byte)
{
    if (s->at >= s->capacity) {
        s->full = true;
        return;
    }
    s->out[s->at] = byte;
    s->at++;
}

static void close_block(struct stuffer *s)
{
    if (s->code < s->capacity) {
        s->out[s->code] = (uint8_t)(s->run + 1u);
    }
    s->code = s->at;
    s->run = 0;
}

/* A full block of 254 is closed only when more follows, so that no empty block ends a packet. */
static void stuff(struct stuffer *s, uint8_t byte)
{
    if (s->run == 254u) {
        close_block(s);
        emit(s, 0);
    }
    if (byte == 0) {
        close_block(s);
        emit(s, 0);
        return;
    }
    emit(s, byte);
    s->run++;
}

enum eit_status eit_packet(const uint8_t *payload, size_t length, uint8_t *out, size_t capacity, size_t *written)
{
    struct stuffer s = {out, capacity, 0, 0, 0, false};
    uint8_t check[EIT_CRC_BYTES];

    *written = 0;
    if (length == 0) {
        return EIT_LENGTH;
    }
    eit_put32(check, eit_crc(payload, length));
    emit(&s, 0);
    for (size_t i = 0; i < length; i++) {
        stuff(&s, payload[i]);
    }
    for (size_t i = 0; i < EIT_CRC_BYTES; i++) {
        stuff(&s, check[i]);
    }
    close_block(&s);
    emit(&s, 0);
    if (s.full) {
        return EIT_SPACE;
    }
    *written = s.at;
    return EIT_OK;
}

static void start_piece(struct eit_deframer *d)
{
    d->used = 0;
    d->seen = 0;
    d->left = 0;
    d->zero_pending = false;
    d->flooded = false;
}

void eit_deframer_init(struct eit_deframer *deframer, uint8_t *buffer, size_t capacity)
{
    deframer->buffer = buffer;
    deframer->capacity = capacity;
    deframer->synchronised = false;
    deframer->packets = 0;
    deframer->corrupt = 0;
    deframer->discarded_bytes = 0;
    start_piece(deframer);
}

static void keep(struct eit_deframer *d, uint8_t byte)
{
    if (d->used >= d->capacity) {
        d->flooded = true;
        return;
    }
    d->buffer[d->used] = byte;
    d->used++;
}

static enum eit_status end_piece(struct eit_deframer *d, size_t *length)
{
    const size_t seen = d->seen;
    const size_t used = d->used;
    const bool whole = !d->flooded && d->left == 0 && used > EIT_CRC_BYTES;
    const bool synchronised = d->synchronised;

    start_piece(d);
    d->synchronised = true;
    if (seen == 0) {
        return EIT_AGAIN; /* two delimiters in a row */
    }
    if (whole && eit_crc(d->buffer, used - EIT_CRC_BYTES) == eit_get32(d->buffer + used - EIT_CRC_BYTES)) {
        d->packets++;
        *length = used - EIT_CRC_BYTES;
        return EIT_OK;
    }
    d->discarded_bytes += (uint32_t)seen;
    if (synchronised) {
        d->corrupt++;
    }
    return EIT_DAMAGED;
}

enum eit_status eit_deframer_push(struct eit_deframer *deframer, uint8_t byte, size_t *length)
{
    *length = 0;
    if (byte == 0) {
        return end_piece(deframer, length);
    }
    deframer->seen++;
    if (deframer->flooded) {
        return EIT_AGAIN;
    }
    if (deframer->left == 0) {
        if (deframer->zero_pending) {
            keep(deframer, 0);
        }
        deframer->left = (uint8_t)(byte - 1u);
        deframer->zero_pending = byte != 0xffu;
    } else {
        keep(deframer, byte);
        deframer->left--;
    }
    return EIT_AGAIN;
}
