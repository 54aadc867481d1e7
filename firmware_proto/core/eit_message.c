#include "eit_message.h"

#include "eit_bytes.h"

static const uint8_t full_measure[EIT_FULL_ROWS] = {EIT_FULL_TABLE_MEASURE};

struct layout {
    uint8_t type;
    uint8_t bytes;
    uint8_t max_tail;
    const char *kinds;
};

static const struct layout layouts[] = {EIT_LAYOUTS};

uint8_t eit_row_measure(bool full, uint8_t drive, uint8_t row)
{
    const uint8_t measure = full_measure[drive * EIT_ROWS_PER_DRIVE + row];

    return full || measure > drive ? measure : EIT_NO_ROW;
}

uint8_t eit_row_count(bool full, uint16_t drives)
{
    unsigned count = 0;

    for (uint8_t drive = 0; drive < EIT_ELECTRODES; drive++) {
        if (((unsigned)drives >> drive & 1u) == 0) {
            continue;
        }
        for (uint8_t row = 0; row < EIT_ROWS_PER_DRIVE; row++) {
            if (eit_row_measure(full, drive, row) != EIT_NO_ROW) {
                count++;
            }
        }
    }
    return (uint8_t)count;
}

uint8_t eit_drive_count(bool full, uint16_t drives)
{
    unsigned count = 0;

    for (unsigned drive = 0; drive < EIT_ELECTRODES; drive++) {
        if (((unsigned)drives >> drive & 1u) != 0 && eit_row_count(full, (uint16_t)(1u << drive)) != 0) {
            count++;
        }
    }
    return (uint8_t)count;
}

size_t eit_frame_bytes(uint8_t rows, uint8_t sample_bytes)
{
    return EIT_FRAME_BYTES + (size_t)rows * sample_bytes + ((size_t)rows + 7u) / 8u;
}

void eit_frame_put_header(const struct eit_frame *frame, uint8_t *payload)
{
    payload[0] = EIT_TYPE_FRAME;
    payload[EIT_FRAME_FLAGS] = frame->flags;
    payload[EIT_FRAME_SAMPLE_BYTES] = frame->sample_bytes;
    payload[EIT_FRAME_ROWS] = frame->rows;
    eit_put32(payload + EIT_FRAME_GENERATION, frame->generation);
    eit_put32(payload + EIT_FRAME_SEQUENCE, frame->sequence);
    eit_put32(payload + EIT_FRAME_DEVICE_US, frame->device_us);
    eit_put16(payload + EIT_FRAME_DRIVES, frame->drives);
    eit_put16(payload + EIT_FRAME_DEVICE_DROPPED, frame->device_dropped);
}

/* Round a left-justified value to the sample's width. Adding half a step may pass full scale, hence the 64 bits. */
void eit_frame_put_sample(uint8_t *payload, uint8_t sample_bytes, uint8_t row, int32_t value)
{
    uint8_t *at = payload + EIT_FRAME_BYTES + (size_t)row * sample_bytes;
    const int64_t step = (int64_t)1 << (8u * (4u - sample_bytes));
    const int64_t largest = ((int64_t)1 << (8u * sample_bytes - 1u)) - 1;
    int64_t shifted = (int64_t)value + step / 2;
    uint32_t bits;

    /* Division towards minus infinity without shifting a negative number. */
    shifted = (shifted >= 0) ? shifted / step : -((-shifted + step - 1) / step);
    if (shifted > largest) {
        shifted = largest;
    }
    bits = (uint32_t)(uint64_t)shifted;
    for (uint8_t i = 0; i < sample_bytes; i++) {
        at[i] = (uint8_t)((bits >> (8u * i)) & 0xffu);
    }
}

int32_t eit_frame_get_sample(const uint8_t *payload, uint8_t sample_bytes, uint8_t row)
{
    const uint8_t *at = payload + EIT_FRAME_BYTES + (size_t)row * sample_bytes;
    const uint32_t sign = (uint32_t)1 << (8u * sample_bytes - 1u);
    uint32_t bits = 0;

    for (uint8_t i = 0; i < sample_bytes; i++) {
        bits |= (uint32_t)at[i] << (8u * i);
    }
    /* (bits ^ sign) - sign extends the sign; done in 64 bits, where nothing overflows. */
    return (int32_t)((int64_t)(bits ^ sign) - (int64_t)sign);
}

enum eit_status eit_frame_get_header(const uint8_t *payload, size_t length, struct eit_frame *frame)
{
    if (length < EIT_FRAME_BYTES || payload[0] != EIT_TYPE_FRAME) {
        return EIT_TYPE;
    }
    frame->flags = payload[EIT_FRAME_FLAGS];
    frame->sample_bytes = payload[EIT_FRAME_SAMPLE_BYTES];
    frame->rows = payload[EIT_FRAME_ROWS];
    frame->generation = eit_get32(payload + EIT_FRAME_GENERATION);
    frame->sequence = eit_get32(payload + EIT_FRAME_SEQUENCE);
    frame->device_us = eit_get32(payload + EIT_FRAME_DEVICE_US);
    frame->drives = eit_get16(payload + EIT_FRAME_DRIVES);
    frame->device_dropped = eit_get16(payload + EIT_FRAME_DEVICE_DROPPED);
    if (frame->sample_bytes < 2u || frame->sample_bytes > 4u || frame->rows == 0 ||
        frame->rows != eit_row_count((frame->flags & EIT_FRAME_FLAG_FULL) != 0, frame->drives)) {
        return EIT_VALUE;
    }
    if (length != eit_frame_bytes(frame->rows, frame->sample_bytes)) {
        return EIT_LENGTH;
    }
    if (frame->rows % 8u != 0 && payload[length - 1u] >> (frame->rows % 8u) != 0) {
        return EIT_VALUE; /* saturation of rows that do not exist */
    }
    return EIT_OK;
}

bool eit_is_text16(const uint8_t *at)
{
    size_t length = 16;

    while (length > 0 && at[length - 1u] == 0) {
        length--;
    }
    for (size_t i = 0; i < length; i++) {
        if (at[i] < 0x20u || at[i] > 0x7eu) {
            return false;
        }
    }
    return true;
}

/* A double is finite unless its eleven exponent bits are all ones. */
static bool is_finite_double(const uint8_t *at)
{
    return !((at[7] & 0x7fu) == 0x7fu && (at[6] & 0xf0u) == 0xf0u);
}

static size_t kind_bytes(char kind)
{
    switch (kind) {
    case '1': return 1;
    case '2': return 2;
    case 'v': return 3;
    case '4': case 'M': return 4;
    case 'f': case 'i': return 8;
    case 't': return 16;
    default: return 0; /* the tail */
    }
}

static enum eit_status check_fields(const struct layout *layout, const uint8_t *payload)
{
    static const uint8_t magic[4] = EIT_MAGIC;
    const uint8_t *at = payload + 1;

    for (const char *kind = layout->kinds; *kind != '\0'; kind++) {
        if ((*kind == 'M' && !eit_same(at, magic, sizeof magic)) || (*kind == 't' && !eit_is_text16(at)) ||
            (*kind == 'f' && !is_finite_double(at))) {
            return EIT_VALUE;
        }
        at += kind_bytes(*kind);
    }
    return EIT_OK;
}

enum eit_status eit_message_check(const uint8_t *payload, size_t length)
{
    static const uint8_t magic[4] = EIT_MAGIC;
    struct eit_frame frame;
    bool later = false; /* a HELLO of a later minor version may be longer */

    if (length == 0) {
        return EIT_LENGTH;
    }
    if (payload[0] == EIT_TYPE_FRAME) {
        return eit_frame_get_header(payload, length, &frame);
    }
    if (payload[0] == EIT_TYPE_HELLO && length >= 8u) {
        if (eit_same(payload + EIT_HELLO_MAGIC, magic, sizeof magic) &&
            payload[EIT_HELLO_PROTOCOL_MAJOR] != EIT_PROTOCOL_MAJOR) {
            return EIT_VERSION;
        }
        later = payload[EIT_HELLO_PROTOCOL_MINOR] > EIT_PROTOCOL_MINOR;
    }
    for (size_t i = 0; i < sizeof layouts / sizeof layouts[0]; i++) {
        const struct layout *layout = &layouts[i];

        if (layout->type != payload[0]) {
            continue;
        }
        if (length < layout->bytes || (length > (size_t)layout->bytes + layout->max_tail && !later)) {
            return EIT_LENGTH;
        }
        return check_fields(layout, payload);
    }
    return EIT_TYPE;
}
