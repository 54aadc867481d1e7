#include "eit_reply.h"

#include <string.h>

#include "eit_bytes.h"

bool eit_reply_send(struct eit_device *device, const uint8_t *payload, size_t length)
{
    size_t written;

    if (eit_packet(payload, length, device->packet, sizeof device->packet, &written) != EIT_OK) {
        return false;
    }
    return device->port->write(device->port->ctx, device->packet, written);
}

/* The port gives volts a step of 32 bit; a step of fewer bits is a power of two larger. */
static void put_scale(const struct eit_device *device, uint8_t *at)
{
    const double steps = (double)(1u << (8u * (4u - device->config.sample_bytes)));
    const double volts = device->port->volts_per_count(device->port->ctx, &device->config) * steps;
    uint64_t bits;

    memcpy(&bits, &volts, sizeof bits);
    eit_put32(at, (uint32_t)(bits & 0xffffffffu));
    eit_put32(at + 4, (uint32_t)(bits >> 32));
}

static uint8_t hello_flags(const struct eit_device *device)
{
    unsigned flags = 0;

    flags |= eit_config_is_full(&device->config) ? EIT_HELLO_FLAG_FULL : 0u;
    flags |= device->store.trial ? EIT_HELLO_FLAG_TRIAL : 0u;
    flags |= device->store.active == EIT_NO_SLOT ? EIT_HELLO_FLAG_FACTORY : 0u;
    flags |= device->store.gave_up ? EIT_HELLO_FLAG_ROLLED_BACK : 0u;
    flags |= device->streaming ? EIT_HELLO_FLAG_STREAMING : 0u;
    flags |= device->idle ? EIT_HELLO_FLAG_IDLE : 0u;
    return (uint8_t)flags;
}

void eit_reply_hello(struct eit_device *device, uint8_t tag)
{
    static const uint8_t magic[] = EIT_MAGIC;
    static const uint8_t protocol_id[] = EIT_PROTOCOL_ID;
    static const uint8_t grid_id[] = EIT_GRID_ID;
    const struct eit_config *config = &device->config;
    uint8_t *at = device->reply;

    at[0] = EIT_TYPE_HELLO;
    at[EIT_HELLO_TAG] = tag;
    eit_copy(at + EIT_HELLO_MAGIC, magic, sizeof magic);
    at[EIT_HELLO_PROTOCOL_MAJOR] = EIT_PROTOCOL_MAJOR;
    at[EIT_HELLO_PROTOCOL_MINOR] = EIT_PROTOCOL_MINOR;
    eit_copy(at + EIT_HELLO_PROTOCOL_ID, protocol_id, sizeof protocol_id);
    eit_copy(at + EIT_HELLO_GRID_ID, config->has_skin ? config->skin : grid_id, sizeof grid_id);
    eit_copy(at + EIT_HELLO_FIRMWARE_VERSION, device->identity->firmware_version, 3);
    at[EIT_HELLO_FLAGS] = hello_flags(device);
    eit_put32(at + EIT_HELLO_HARDWARE_ID, EIT_HARDWARE_ID);
    eit_copy(at + EIT_HELLO_SERIAL_NUMBER, device->identity->serial_number, 16);
    eit_put32(at + EIT_HELLO_CONFIGURATION_DIGEST, config->digest);
    eit_put32(at + EIT_HELLO_GENERATION, device->store.generation);
    eit_copy(at + EIT_HELLO_CONFIGURATION_NAME, config->name, sizeof config->name);
    eit_put32(at + EIT_HELLO_RATE_MHZ, config->rate_mHz);
    at[EIT_HELLO_ROWS] = eit_row_count(eit_config_is_full(config), config->drives);
    at[EIT_HELLO_SAMPLE_BYTES] = config->sample_bytes;
    eit_put16(at + EIT_HELLO_DRIVES, config->drives);
    eit_put16(at + EIT_HELLO_IDLE_DRIVES, config->idle_drives);
    eit_put16(at + EIT_HELLO_MAX_PAYLOAD, EIT_MAX_REQUEST_BYTES);
    eit_put32(at + EIT_HELLO_UPTIME_MS, (uint32_t)((device->uptime_us / 1000u) & 0xffffffffu));
    eit_put32(at + EIT_HELLO_LINE_BYTES_PER_S, device->identity->line_bytes_per_s);
    put_scale(device, at + EIT_HELLO_VOLTS_PER_COUNT);
    (void)eit_reply_send(device, at, EIT_HELLO_BYTES);
}

void eit_reply_ack(struct eit_device *device, const uint8_t *request, uint8_t code, uint32_t detail)
{
    uint8_t *at = device->reply;
    const uint8_t type = request[0];
    const uint8_t tag = request[1];

    at[0] = EIT_TYPE_ACK;
    at[EIT_ACK_TAG] = tag;
    at[EIT_ACK_REQUEST] = type;
    at[EIT_ACK_CODE] = code;
    eit_put32(at + EIT_ACK_DETAIL, detail);
    (void)eit_reply_send(device, at, EIT_ACK_BYTES);
}

void eit_reply_time(struct eit_device *device, uint8_t tag, uint32_t now_us)
{
    uint8_t *at = device->reply;

    at[0] = EIT_TYPE_TIME;
    at[EIT_TIME_TAG] = tag;
    eit_put32(at + EIT_TIME_DEVICE_US, now_us);
    (void)eit_reply_send(device, at, EIT_TIME_BYTES);
}

void eit_reply_event(struct eit_device *device, uint8_t code, uint32_t now_us, uint32_t detail)
{
    uint8_t *at = device->reply;

    at[0] = EIT_TYPE_EVENT;
    at[EIT_EVENT_CODE] = code;
    eit_put32(at + EIT_EVENT_DEVICE_US, now_us);
    eit_put32(at + EIT_EVENT_DETAIL, detail);
    (void)eit_reply_send(device, at, EIT_EVENT_BYTES);
}

void eit_reply_config_data(struct eit_device *device, uint8_t tag, uint8_t slot, uint32_t generation,
                           const uint8_t *blob, uint16_t offset, uint8_t length)
{
    uint8_t *at = device->reply;

    at[0] = EIT_TYPE_CONFIG_DATA;
    at[EIT_CONFIG_DATA_TAG] = tag;
    at[EIT_CONFIG_DATA_SLOT] = slot;
    eit_put32(at + EIT_CONFIG_DATA_GENERATION, generation);
    eit_put16(at + EIT_CONFIG_DATA_OFFSET, offset);
    eit_put16(at + EIT_CONFIG_DATA_TOTAL, EIT_CONFIG_BYTES);
    eit_copy(at + EIT_CONFIG_DATA_DATA, blob + offset, length);
    (void)eit_reply_send(device, at, (size_t)EIT_CONFIG_DATA_DATA + length);
}
