#include "eit_request.h"

#include "eit_bytes.h"
#include "eit_reply.h"

/* Code and detail of an ACK. */
struct answer {
    uint8_t code;
    uint32_t detail;
};

static struct answer answer(uint8_t code, uint32_t detail)
{
    const struct answer made = {code, detail};

    return made;
}

/* What a status of the store or of a configuration is on the wire. */
static uint8_t code_of(enum eit_status status)
{
    switch (status) {
    case EIT_OK: return EIT_CODE_OK;
    case EIT_DAMAGED: return EIT_CODE_DIGEST_MISMATCH;
    case EIT_VERSION: return EIT_CODE_BAD_FORMAT;
    case EIT_HARDWARE: return EIT_CODE_WRONG_HARDWARE;
    case EIT_RATE: return EIT_CODE_RATE_TOO_HIGH;
    case EIT_EMPTY: return EIT_CODE_NO_PREVIOUS;
    case EIT_STORAGE: return EIT_CODE_STORAGE_FAILED;
    default: return EIT_CODE_INVALID_CONFIGURATION;
    }
}

/* Milliseconds until the lock expires; 0 if nobody holds it. */
static uint32_t lock_left_ms(struct eit_device *device, uint32_t now_us)
{
    const uint32_t silent_us = now_us - device->token_us;

    if (device->token == 0) {
        return 0;
    }
    if (silent_us >= EIT_LOCK_US) {
        device->token = 0;
        device->begun = false;
        return 0;
    }
    return 1u + (EIT_LOCK_US - silent_us) / 1000u;
}

/* Take the lock, or keep it alive. */
static struct answer take_lock(struct eit_device *device, uint32_t token, uint32_t now_us)
{
    const uint32_t left_ms = lock_left_ms(device, now_us);

    if (token == 0) {
        return answer(EIT_CODE_BAD_VALUE, 0);
    }
    if (left_ms != 0 && token != device->token) {
        return answer(EIT_CODE_BUSY, left_ms);
    }
    device->token = token;
    device->token_us = now_us;
    return answer(EIT_CODE_OK, 0);
}

/* Require an open session of this token. */
static struct answer need_session(struct eit_device *device, uint32_t token, uint32_t now_us)
{
    const uint32_t left_ms = lock_left_ms(device, now_us);

    if (left_ms != 0 && token != device->token) {
        return answer(EIT_CODE_BUSY, left_ms);
    }
    if (left_ms == 0 || !device->begun) {
        return answer(EIT_CODE_NO_SESSION, 0);
    }
    device->token_us = now_us;
    return answer(EIT_CODE_OK, 0);
}

static struct answer start(struct eit_device *device, const uint8_t *payload, uint32_t now_us)
{
    device->streaming = true;
    device->scanning = false;
    device->first = true;
    device->overrun_reported = false;
    device->frames_left = eit_get32(payload + EIT_START_FRAMES);
    device->dropped = 0;
    device->next_us = now_us;
    device->remainder = 0;
    return answer(EIT_CODE_OK, device->sequence);
}

static struct answer set_mode(struct eit_device *device, const uint8_t *payload)
{
    const uint8_t mode = payload[EIT_SET_MODE_MODE];

    if (mode > EIT_MODE_IDLE || (mode == EIT_MODE_IDLE && device->config.idle_drives == 0)) {
        return answer(EIT_CODE_BAD_VALUE, mode);
    }
    device->idle = mode == EIT_MODE_IDLE;
    return answer(EIT_CODE_OK, mode);
}

/* Answers with CONFIG_DATA itself and returns OK, or an error for the ACK. */
static struct answer config_read(struct eit_device *device, const uint8_t *payload)
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
        return answer(EIT_CODE_BAD_VALUE, EIT_CONFIG_BYTES);
    }
    if (slot == EIT_SLOT_OTHER && device->begun) {
        generation = device->committed_generation; /* 0 while it is being written */
        device->port->storage_read(device->port->ctx, other, 0, blob, sizeof blob);
    } else if (slot == EIT_SLOT_OTHER) {
        status = eit_store_read(&device->store, other, blob, &generation);
    } else if (device->store.active == EIT_NO_SLOT) {
        eit_copy(blob, eit_config_factory_blob(), sizeof blob);
    } else {
        status = eit_store_read(&device->store, device->store.active, blob, &generation);
    }
    if (status != EIT_OK) {
        return answer(code_of(status), 0);
    }
    eit_reply_config_data(device, payload[EIT_CONFIG_READ_TAG], slot, generation, blob, offset, length);
    return answer(EIT_CODE_OK, 0);
}

static struct answer config_begin(struct eit_device *device, const uint8_t *payload, uint32_t now_us)
{
    const struct eit_config *active = &device->config;
    const uint32_t revision = eit_get32(payload + EIT_CONFIG_BEGIN_REVISION);
    struct answer lock;
    enum eit_status status;

    if (device->streaming) {
        return answer(EIT_CODE_STREAMING, 0);
    }
    if (eit_get32(payload + EIT_CONFIG_BEGIN_HARDWARE_ID) != EIT_HARDWARE_ID) {
        return answer(EIT_CODE_WRONG_HARDWARE, EIT_HARDWARE_ID);
    }
    if (payload[EIT_CONFIG_BEGIN_FORMAT] != EIT_CONFIG_FORMAT_KNOWN) {
        return answer(EIT_CODE_BAD_FORMAT, EIT_CONFIG_FORMAT_KNOWN);
    }
    if (eit_get16(payload + EIT_CONFIG_BEGIN_SIZE) != EIT_CONFIG_BYTES) {
        return answer(EIT_CODE_TOO_LARGE, EIT_CONFIG_BYTES);
    }
    if (payload[EIT_CONFIG_BEGIN_ALLOW_DOWNGRADE] == 0 && revision < active->revision &&
        eit_same(payload + EIT_CONFIG_BEGIN_NAME, active->name, sizeof active->name)) {
        return answer(EIT_CODE_DOWNGRADE, active->revision);
    }
    if (device->store.trial) {
        return answer(EIT_CODE_NOT_CONFIRMED, device->store.generation);
    }
    lock = take_lock(device, eit_get32(payload + EIT_CONFIG_BEGIN_TOKEN), now_us);
    if (lock.code != EIT_CODE_OK) {
        return lock;
    }
    device->begun = false;
    device->committed_generation = 0;
    device->begun_digest = eit_get32(payload + EIT_CONFIG_BEGIN_DIGEST);
    status = eit_store_begin(&device->store);
    if (status != EIT_OK) {
        device->token = 0;
        return answer(code_of(status), 0);
    }
    device->begun = true;
    return answer(EIT_CODE_OK, EIT_CONFIG_BYTES);
}

/* A chunk that was written already is accepted again if it ends where the blob does now: its answer was lost. */
static struct answer config_write(struct eit_device *device, const uint8_t *payload, size_t length)
{
    const uint16_t offset = eit_get16(payload + EIT_CONFIG_WRITE_OFFSET);
    const uint8_t *data = payload + EIT_CONFIG_WRITE_DATA;
    const uint32_t bytes = (uint32_t)(length - EIT_CONFIG_WRITE_DATA);
    enum eit_status status;

    if (bytes == 0 || bytes % 4u != 0) {
        return answer(EIT_CODE_BAD_VALUE, bytes);
    }
    if (offset + bytes == device->store.written) {
        uint8_t there[EIT_CHUNK_BYTES];

        device->port->storage_read(device->port->ctx, eit_store_other(&device->store), offset, there, bytes);
        if (eit_same(there, data, bytes)) {
            return answer(EIT_CODE_OK, device->store.written);
        }
    }
    if (offset != device->store.written || bytes > EIT_CONFIG_BYTES - device->store.written) {
        return answer(EIT_CODE_BAD_OFFSET, device->store.written);
    }
    status = eit_store_write(&device->store, data, bytes);
    return answer(code_of(status), device->store.written);
}

static struct answer config_verify(struct eit_device *device)
{
    struct eit_config config;
    enum eit_status status;

    if (device->store.written != EIT_CONFIG_BYTES) {
        return answer(EIT_CODE_INCOMPLETE, device->store.written);
    }
    status = eit_store_verify(&device->store, &config);
    if (status != EIT_OK) {
        return answer(code_of(status), 0);
    }
    return answer(config.digest == device->begun_digest ? EIT_CODE_OK : EIT_CODE_DIGEST_MISMATCH, config.digest);
}

static struct answer config_commit(struct eit_device *device, const uint8_t *payload)
{
    const uint32_t digest = eit_get32(payload + EIT_CONFIG_COMMIT_DIGEST);
    struct answer verified;
    uint32_t generation = 0;
    enum eit_status status;

    if (device->committed_generation != 0 && digest == device->begun_digest) {
        return answer(EIT_CODE_OK, device->committed_generation); /* asked again: the answer was lost */
    }
    verified = config_verify(device);
    if (verified.code != EIT_CODE_OK) {
        return verified;
    }
    if (verified.detail != digest) {
        return answer(EIT_CODE_DIGEST_MISMATCH, verified.detail);
    }
    status = eit_store_commit(&device->store, digest, &generation);
    device->committed_generation = generation; /* session and lock stay until RESTART */
    return answer(code_of(status), generation);
}

static struct answer config_confirm(struct eit_device *device, const uint8_t *payload)
{
    if (eit_get32(payload + EIT_CONFIG_CONFIRM_GENERATION) != device->store.generation ||
        eit_get32(payload + EIT_CONFIG_CONFIRM_DIGEST) != device->config.digest) {
        return answer(EIT_CODE_WRONG_GENERATION, device->store.generation);
    }
    return answer(code_of(eit_store_confirm(&device->store)), device->store.generation);
}

static struct answer config_rollback(struct eit_device *device, const uint8_t *payload, uint32_t now_us)
{
    struct answer lock;
    enum eit_status status;

    if (device->streaming) {
        return answer(EIT_CODE_STREAMING, 0);
    }
    if (eit_get32(payload + EIT_CONFIG_ROLLBACK_GENERATION) != device->store.generation) {
        return answer(EIT_CODE_WRONG_GENERATION, device->store.generation);
    }
    lock = take_lock(device, eit_get32(payload + EIT_CONFIG_ROLLBACK_TOKEN), now_us);
    if (lock.code != EIT_CODE_OK) {
        return lock;
    }
    device->begun = false;
    status = eit_store_revoke(&device->store);
    if (status != EIT_OK) {
        device->token = 0;
    }
    return answer(code_of(status), device->store.generation);
}

static struct answer restart(struct eit_device *device, const uint8_t *payload, uint32_t now_us)
{
    const uint32_t left_ms = lock_left_ms(device, now_us);
    const uint32_t token = eit_get32(payload + EIT_RESTART_TOKEN);

    if (left_ms != 0 && token != device->token) {
        return answer(EIT_CODE_BUSY, left_ms);
    }
    /* A session's RESTART that is asked again after the restart, because its answer was lost, must not end the trial. */
    if (left_ms == 0 && token != 0) {
        return answer(EIT_CODE_NO_SESSION, 0);
    }
    device->streaming = false;
    device->restarting = true;
    device->restart_us = now_us + EIT_RESTART_US;
    return answer(EIT_CODE_OK, 0);
}

static struct answer config_abort(struct eit_device *device)
{
    device->token = 0;
    device->begun = false;
    return answer(EIT_CODE_OK, 0);
}

/* Requests that need an open session; their token is the first field after the tag. */
static struct answer in_session(struct eit_device *device, const uint8_t *payload, size_t length, uint32_t now_us)
{
    const struct answer session = need_session(device, eit_get32(payload + EIT_CONFIG_VERIFY_TOKEN), now_us);

    if (session.code != EIT_CODE_OK) {
        return session;
    }
    switch (payload[0]) {
    case EIT_TYPE_CONFIG_WRITE: return config_write(device, payload, length);
    case EIT_TYPE_CONFIG_VERIFY: return config_verify(device);
    case EIT_TYPE_CONFIG_COMMIT: return config_commit(device, payload);
    default: return config_abort(device);
    }
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
    struct answer made;

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
        made = config_read(device, payload);
        if (made.code == EIT_CODE_OK) {
            return; /* answered with the data */
        }
        break;
    case EIT_TYPE_START: made = start(device, payload, now_us); break;
    case EIT_TYPE_STOP:
        device->streaming = false;
        made = answer(EIT_CODE_OK, device->sequence);
        break;
    case EIT_TYPE_SET_MODE: made = set_mode(device, payload); break;
    case EIT_TYPE_CONFIG_BEGIN: made = config_begin(device, payload, now_us); break;
    case EIT_TYPE_CONFIG_CONFIRM: made = config_confirm(device, payload); break;
    case EIT_TYPE_CONFIG_ROLLBACK: made = config_rollback(device, payload, now_us); break;
    case EIT_TYPE_RESTART: made = restart(device, payload, now_us); break;
    default: made = in_session(device, payload, length, now_us); break;
    }
    eit_reply_ack(device, payload, made.code, made.detail);
}
