#include "eit_flash.h"

#include "eit_bytes.h"

/* What a status of the store or of a configuration is on the wire. */
uint8_t eit_flash_code(enum eit_status status)
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

/* Milliseconds until the lock expires; 0 if the lock is free. */
uint32_t eit_flash_lock_ms(struct eit_device *device, uint32_t now_us)
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
static struct eit_answer take_lock(struct eit_device *device, uint32_t token, uint32_t now_us)
{
    const uint32_t left_ms = eit_flash_lock_ms(device, now_us);

    if (token == 0) {
        return eit_answer(EIT_CODE_BAD_VALUE, 0);
    }
    if (left_ms != 0 && token != device->token) {
        return eit_answer(EIT_CODE_BUSY, left_ms);
    }
    device->token = token;
    device->token_us = now_us;
    return eit_answer(EIT_CODE_OK, 0);
}

/* Require an open session of this token. */
static struct eit_answer need_session(struct eit_device *device, uint32_t token, uint32_t now_us)
{
    const uint32_t left_ms = eit_flash_lock_ms(device, now_us);

    if (left_ms != 0 && token != device->token) {
        return eit_answer(EIT_CODE_BUSY, left_ms);
    }
    if (left_ms == 0 || !device->begun) {
        return eit_answer(EIT_CODE_NO_SESSION, 0);
    }
    device->token_us = now_us;
    return eit_answer(EIT_CODE_OK, 0);
}

struct eit_answer eit_flash_begin(struct eit_device *device, const uint8_t *payload, uint32_t now_us)
{
    const struct eit_config *active = &device->config;
    const uint32_t revision = eit_get32(payload + EIT_CONFIG_BEGIN_REVISION);
    struct eit_answer lock;
    enum eit_status status;

    if (device->streaming) {
        return eit_answer(EIT_CODE_STREAMING, 0);
    }
    if (eit_get32(payload + EIT_CONFIG_BEGIN_HARDWARE_ID) != EIT_HARDWARE_ID) {
        return eit_answer(EIT_CODE_WRONG_HARDWARE, EIT_HARDWARE_ID);
    }
    if (payload[EIT_CONFIG_BEGIN_FORMAT] != EIT_CONFIG_FORMAT_KNOWN) {
        return eit_answer(EIT_CODE_BAD_FORMAT, EIT_CONFIG_FORMAT_KNOWN);
    }
    if (eit_get16(payload + EIT_CONFIG_BEGIN_SIZE) != EIT_CONFIG_BYTES) {
        return eit_answer(EIT_CODE_TOO_LARGE, EIT_CONFIG_BYTES);
    }
    if (payload[EIT_CONFIG_BEGIN_ALLOW_DOWNGRADE] == 0 && revision < active->revision &&
        eit_same(payload + EIT_CONFIG_BEGIN_NAME, active->name, sizeof active->name)) {
        return eit_answer(EIT_CODE_DOWNGRADE, active->revision);
    }
    if (!eit_store_may_begin(&device->store)) {
        return eit_answer(EIT_CODE_NOT_CONFIRMED, device->store.generation);
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
        return eit_answer(eit_flash_code(status), 0);
    }
    device->begun = true;
    return eit_answer(EIT_CODE_OK, EIT_CONFIG_BYTES);
}

/* A chunk that was written already is accepted again if it ends where the blob does now: its answer was lost. */
static struct eit_answer config_write(struct eit_device *device, const uint8_t *payload, size_t length)
{
    const uint16_t offset = eit_get16(payload + EIT_CONFIG_WRITE_OFFSET);
    const uint8_t *data = payload + EIT_CONFIG_WRITE_DATA;
    const uint32_t bytes = (uint32_t)(length - EIT_CONFIG_WRITE_DATA);
    enum eit_status status;

    if (bytes == 0 || bytes % 4u != 0) {
        return eit_answer(EIT_CODE_BAD_VALUE, bytes);
    }
    if (offset + bytes == device->store.written) {
        uint8_t there[EIT_CHUNK_BYTES];

        device->port->storage_read(device->port->ctx, eit_store_other(&device->store), offset, there, bytes);
        if (eit_same(there, data, bytes)) {
            return eit_answer(EIT_CODE_OK, device->store.written);
        }
    }
    if (offset != device->store.written || bytes > EIT_CONFIG_BYTES - device->store.written) {
        return eit_answer(EIT_CODE_BAD_OFFSET, device->store.written);
    }
    status = eit_store_write(&device->store, data, bytes);
    return eit_answer(eit_flash_code(status), device->store.written);
}

static struct eit_answer config_verify(struct eit_device *device)
{
    struct eit_config config;
    enum eit_status status;

    if (device->store.written != EIT_CONFIG_BYTES) {
        return eit_answer(EIT_CODE_INCOMPLETE, device->store.written);
    }
    status = eit_store_verify(&device->store, &config);
    if (status != EIT_OK) {
        return eit_answer(eit_flash_code(status), 0);
    }
    return eit_answer(config.digest == device->begun_digest ? EIT_CODE_OK : EIT_CODE_DIGEST_MISMATCH, config.digest);
}

static struct eit_answer config_commit(struct eit_device *device, const uint8_t *payload)
{
    const uint32_t digest = eit_get32(payload + EIT_CONFIG_COMMIT_DIGEST);
    struct eit_answer verified;
    uint32_t generation = 0;
    enum eit_status status;

    if (device->committed_generation != 0 && digest == device->begun_digest) {
        return eit_answer(EIT_CODE_OK, device->committed_generation); /* asked again: the answer was lost */
    }
    verified = config_verify(device);
    if (verified.code != EIT_CODE_OK) {
        return verified;
    }
    if (verified.detail != digest) {
        return eit_answer(EIT_CODE_DIGEST_MISMATCH, verified.detail);
    }
    status = eit_store_commit(&device->store, digest, &generation);
    device->committed_generation = generation; /* session and lock stay until RESTART */
    return eit_answer(eit_flash_code(status), generation);
}

struct eit_answer eit_flash_confirm(struct eit_device *device, const uint8_t *payload)
{
    if (eit_get32(payload + EIT_CONFIG_CONFIRM_GENERATION) != device->store.generation ||
        eit_get32(payload + EIT_CONFIG_CONFIRM_DIGEST) != device->config.digest) {
        return eit_answer(EIT_CODE_WRONG_GENERATION, device->store.generation);
    }
    if (eit_store_is_revoked(&device->store)) { /* the next boot does not run it, whatever is said now */
        return eit_answer(EIT_CODE_NOT_CONFIRMED, device->store.generation);
    }
    return eit_answer(eit_flash_code(eit_store_confirm(&device->store)), device->store.generation);
}

struct eit_answer eit_flash_rollback(struct eit_device *device, const uint8_t *payload, uint32_t now_us)
{
    struct eit_answer lock;
    enum eit_status status;

    if (device->streaming) {
        return eit_answer(EIT_CODE_STREAMING, 0);
    }
    if (eit_get32(payload + EIT_CONFIG_ROLLBACK_GENERATION) != device->store.generation) {
        return eit_answer(EIT_CODE_WRONG_GENERATION, device->store.generation);
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
    return eit_answer(eit_flash_code(status), device->store.generation);
}

static struct eit_answer config_abort(struct eit_device *device)
{
    device->token = 0;
    device->begun = false;
    return eit_answer(EIT_CODE_OK, 0);
}

/* Requests that need an open session; their token is the first field after the tag. */
struct eit_answer eit_flash_in_session(struct eit_device *device, const uint8_t *payload, size_t length,
                                       uint32_t now_us)
{
    const struct eit_answer session = need_session(device, eit_get32(payload + EIT_CONFIG_VERIFY_TOKEN), now_us);

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
