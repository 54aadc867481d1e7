#include "eit_request.h"

#include "eit_bytes.h"
#include "eit_flash.h"
#include "eit_reply.h"

static struct eit_answer start(struct eit_device *device, const uint8_t *payload, uint32_t now_us)
{
    device->streaming = true;
    device->scanning = false;
    device->first = true;
    device->overrun_reported = false;
    device->switched = false;
    device->frames_left = eit_get32(payload + EIT_START_FRAMES);
    device->dropped = 0;
    device->next_us = now_us;
    device->remainder = 0;
    return eit_answer(EIT_CODE_OK, device->sequence);
}

static struct eit_answer set_mode(struct eit_device *device, const uint8_t *payload)
{
    const uint8_t mode = payload[EIT_SET_MODE_MODE];
    const bool idle = mode == EIT_MODE_IDLE;

    if (mode > EIT_MODE_IDLE || (idle && device->config.idle_drives == 0)) {
        return eit_answer(EIT_CODE_BAD_VALUE, mode);
    }
    device->switched = device->switched || device->idle != idle;
    device->idle = idle;
    return eit_answer(EIT_CODE_OK, mode);
}

/* Answers with CONFIG_DATA itself and returns OK, or an error for the ACK. */
static struct eit_answer config_read(struct eit_device *device, const uint8_t *payload, uint32_t now_us)
{
    const uint8_t slot = payload[EIT_CONFIG_READ_SLOT];
    const uint16_t offset = eit_get16(payload + EIT_CONFIG_READ_OFFSET);
    const uint8_t length = payload[EIT_CONFIG_READ_LENGTH];
    const uint8_t other = eit_store_other(&device->store);
    uint8_t blob[EIT_CONFIG_BYTES];
    uint32_t generation = device->store.generation;
    enum eit_status status = EIT_OK;

    if (slot > EIT_SLOT_OTHER || length == 0 || length > EIT_CHUNK_BYTES || offset > EIT_CONFIG_BYTES ||
        length > EIT_CONFIG_BYTES - offset) {
        return eit_answer(EIT_CODE_BAD_VALUE, EIT_CONFIG_BYTES);
    }
    (void)eit_flash_lock_ms(device, now_us); /* a session that has expired is over */
    if (slot == EIT_SLOT_OTHER && device->begun) {
        generation = device->committed_generation; /* 0 while it is being written */
        device->port->storage_read(device->port->ctx, other, 0, blob, sizeof blob);
    } else if (slot == EIT_SLOT_OTHER) {
        status = eit_store_read(&device->store, other, blob, &generation);
    } else if (device->store.active == EIT_NO_SLOT) {
        eit_copy(blob, eit_config_factory_blob(), sizeof blob);
    } else { /* it runs, even if a rollback has revoked it for the next boot */
        device->port->storage_read(device->port->ctx, device->store.active, 0, blob, sizeof blob);
        if (eit_store_is_revoked(&device->store)) {
            generation = 0;
        }
    }
    if (status != EIT_OK) {
        return eit_answer(eit_flash_code(status), 0);
    }
    eit_reply_config_data(device, payload[EIT_CONFIG_READ_TAG], slot, generation, blob, offset, length);
    return eit_answer(EIT_CODE_OK, 0);
}

static struct eit_answer restart(struct eit_device *device, const uint8_t *payload, uint32_t now_us)
{
    const uint32_t left_ms = eit_flash_lock_ms(device, now_us);
    const uint32_t token = eit_get32(payload + EIT_RESTART_TOKEN);

    if (left_ms != 0 && token != device->token) {
        return eit_answer(EIT_CODE_BUSY, left_ms);
    }
    /* A session's RESTART, asked again after the restart because its answer was lost, must not end the trial. */
    if (left_ms == 0 && token != 0) {
        return eit_answer(EIT_CODE_NO_SESSION, 0);
    }
    device->streaming = false;
    device->restarting = true;
    device->restart_us = now_us + EIT_RESTART_US;
    return eit_answer(EIT_CODE_OK, 0);
}

static void refuse(struct eit_device *device, const uint8_t *payload, size_t length, enum eit_status status)
{
    const uint8_t head[2] = {payload[0], length > 1u ? payload[1] : (uint8_t)0};
    uint8_t code = EIT_CODE_BAD_VALUE;

    if (status == EIT_TYPE) {
        code = EIT_CODE_UNKNOWN_TYPE;
    } else if (status == EIT_LENGTH) {
        code = EIT_CODE_BAD_LENGTH;
    }
    eit_reply_ack(device, head, code, (uint32_t)length);
}

void eit_request_handle(struct eit_device *device, const uint8_t *payload, size_t length, uint32_t now_us)
{
    const enum eit_status status = (payload[0] & 0x80u) != 0 ? EIT_TYPE : eit_message_check(payload, length);
    struct eit_answer made;

    if (status != EIT_OK) {
        refuse(device, payload, length, status);
        return;
    }
    switch (payload[0]) {
    case EIT_TYPE_HELLO_REQUEST:
        eit_reply_hello(device, payload[1]);
        return;
    case EIT_TYPE_TIME_REQUEST:
        eit_reply_time(device, payload[1], now_us);
        return;
    case EIT_TYPE_CONFIG_READ:
        made = config_read(device, payload, now_us);
        if (made.code == EIT_CODE_OK) {
            return; /* answered with the data */
        }
        break;
    case EIT_TYPE_START: made = start(device, payload, now_us); break;
    case EIT_TYPE_STOP:
        device->streaming = false;
        made = eit_answer(EIT_CODE_OK, device->sequence);
        break;
    case EIT_TYPE_SET_MODE: made = set_mode(device, payload); break;
    case EIT_TYPE_CONFIG_BEGIN: made = eit_flash_begin(device, payload, now_us); break;
    case EIT_TYPE_CONFIG_CONFIRM: made = eit_flash_confirm(device, payload); break;
    case EIT_TYPE_CONFIG_ROLLBACK: made = eit_flash_rollback(device, payload, now_us); break;
    case EIT_TYPE_RESTART: made = restart(device, payload, now_us); break;
    default: made = eit_flash_in_session(device, payload, length, now_us); break;
    }
    eit_reply_ack(device, payload, made.code, made.detail);
}
