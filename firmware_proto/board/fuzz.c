/* The whole device under any input, built with the address and undefined-behaviour sanitizers.
 *
 * An input is a list of records: a length byte, then so many bytes. Records with an even length byte go to the line as
 * they are; odd ones are sent as the payload of an intact packet, so that what lies behind the check is reached.
 * After each record some time passes, and now and then the device is switched off and on. With clang's libFuzzer
 * LLVMFuzzerTestOneInput() is the target; without, main() makes records of every message type and bends them. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "eit_device.h"
#include "host.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* What the inputs reached: proof that they get behind the check and into the store. */
static unsigned long storage_changes;
static unsigned long restarts;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static uint8_t sent[65536];
    struct eit_host *host = malloc(eit_host_bytes());
    size_t at = 0;

    if (host == NULL) {
        return 0;
    }
    eit_host_init(host);
    while (at < size) {
        const uint8_t head = data[at];
        const size_t left = size - at - 1u;
        const size_t length = (size_t)(head >> 1) < left ? (size_t)(head >> 1) : left;
        const uint8_t *record = data + at + 1u;

        if ((head & 1u) != 0) {
            uint8_t packet[EIT_PACKET_BYTES(128u)];
            size_t written;

            if (eit_packet(record, length, packet, sizeof packet, &written) == EIT_OK) {
                eit_host_receive(host, packet, written);
            }
        } else {
            eit_host_receive(host, record, length);
        }
        eit_host_run(host, 30000u, 1000u);
        (void)eit_host_take(host, sent, sizeof sent);
        if (head == 0) {
            eit_host_boot(host);
        }
        at += 1u + length;
    }
    storage_changes += eit_host_changes(host);
    restarts += eit_host_restarts(host);
    free(host);
    return 0;
}

#ifndef EIT_LIBFUZZER
static uint32_t state = 1;

static uint32_t number(uint32_t below)
{
    state ^= state << 13;
    state ^= state >> 17;
    state ^= state << 5;
    return state % below;
}

struct layout {
    uint8_t type;
    uint8_t bytes;
    uint8_t max_tail;
    const char *kinds; /* cppcheck-suppress unusedStructMember ; the generated rows have it */
};

static const struct layout layouts[] = {EIT_LAYOUTS};

/* Write one record and return its length: a request with small numbers in it, so that tokens and offsets meet. */
static size_t make_record(uint8_t *out)
{
    static const uint8_t factory[] = {EIT_FACTORY_BLOB};
    const struct layout *layout = &layouts[number(sizeof layouts / sizeof layouts[0])];
    size_t length = layout->bytes + (layout->max_tail != 0 ? number(layout->max_tail + 1u) : 0u);

    if (number(16) == 0) {
        length = number(120);
    }
    out[0] = (uint8_t)(length << 1 | (number(8) != 0));
    for (size_t i = 0; i < length; i++) {
        out[1u + i] = (uint8_t)(number(4) == 0 ? number(256) : 0);
    }
    if (length > 0) {
        out[1] = layout->type;
    }
    if (layout->type == EIT_TYPE_HELLO_REQUEST && length >= 6u) {
        memcpy(out + 3, "EITS", 4);
    }
    if (layout->type < 0x80u && layout->type > EIT_TYPE_CONFIG_READ && length >= 6u && number(4) != 0) {
        memcpy(out + 3, "\1\0\0\0", 4); /* one token for most */
    }
    if (layout->type == EIT_TYPE_CONFIG_BEGIN && length == layout->bytes && number(4) != 0) {
        out[1 + EIT_CONFIG_BEGIN_SIZE] = EIT_CONFIG_BYTES;
        out[2 + EIT_CONFIG_BEGIN_SIZE] = 0;
        memcpy(out + 1 + EIT_CONFIG_BEGIN_DIGEST, factory + EIT_CONFIG_CRC, 4);
        memcpy(out + 1 + EIT_CONFIG_BEGIN_HARDWARE_ID, factory + EIT_CONFIG_HARDWARE_ID, 4);
        out[1 + EIT_CONFIG_BEGIN_FORMAT] = EIT_CONFIG_FORMAT_KNOWN;
        memset(out + 1 + EIT_CONFIG_BEGIN_NAME, 0, 16);
    }
    if (layout->type == EIT_TYPE_CONFIG_WRITE && number(4) != 0) {
        const uint8_t offset = (uint8_t)(32u * number(2));

        length = EIT_CONFIG_WRITE_DATA + 32u;
        out[0] = (uint8_t)(length << 1 | 1u);
        out[1 + EIT_CONFIG_WRITE_OFFSET] = offset;
        out[2 + EIT_CONFIG_WRITE_OFFSET] = 0;
        memcpy(out + 1 + EIT_CONFIG_WRITE_DATA, factory + offset, 32);
    }
    if (layout->type == EIT_TYPE_CONFIG_COMMIT && length == layout->bytes && number(4) != 0) {
        memcpy(out + 1 + EIT_CONFIG_COMMIT_DIGEST, factory + EIT_CONFIG_CRC, 4);
    }
    return 1u + length;
}

int main(int argc, char **argv)
{
    const unsigned long inputs = argc > 1 ? strtoul(argv[1], NULL, 10) : 1000ul;
    unsigned long records = 0;

    for (unsigned long i = 0; i < inputs; i++) {
        uint8_t input[64 * 128];
        size_t size = 0;

        for (unsigned n = 1u + number(48); n > 0; n--) {
            size += make_record(input + size);
            records++;
        }
        (void)LLVMFuzzerTestOneInput(input, size);
    }
    printf("{\"device_fuzz\": {\"inputs\": %lu, \"records\": %lu, \"storage_changes\": %lu, \"restarts\": %lu}}\n",
           inputs, records, storage_changes, restarts);
    return 0;
}
#endif
