#include "eit_store.h"

#include "eit_bytes.h"
#include "eit_crc.h"

#define ERASED 0xffffffffu

/* What a slot's words say. */
struct slot {
    bool valid;     /* blob and commit word are right, and it is not revoked */
    bool confirmed; /* valid, and the trial was passed */
    bool tried;     /* the trial began */
    uint32_t generation;
    struct eit_config config;
};

static uint32_t read_word(const struct eit_port *port, uint8_t slot, uint32_t offset)
{
    uint8_t raw[4];

    port->storage_read(port->ctx, slot, offset, raw, sizeof raw);
    return eit_get32(raw);
}

/* Program one word and read it back: a faulty storage is found here, not at the next boot. */
static enum eit_status program(const struct eit_port *port, uint8_t slot, uint32_t offset, uint32_t word)
{
    const enum eit_status status = port->storage_program(port->ctx, slot, offset, word);

    if (status != EIT_OK) {
        return status;
    }
    return read_word(port, slot, offset) == word ? EIT_OK : EIT_STORAGE;
}

static uint32_t commit_word(uint32_t digest, uint32_t generation)
{
    uint8_t raw[8];

    eit_put32(raw, digest);
    eit_put32(raw + 4, generation);
    return eit_crc(raw, sizeof raw);
}

/* Read a slot. Its generation is only meaningful if the commit word is right, revoked or not; 0 otherwise. */
static void inspect(const struct eit_port *port, uint8_t index, struct slot *slot)
{
    uint8_t blob[EIT_CONFIG_BYTES];
    const uint32_t generation = read_word(port, index, EIT_SLOT_GENERATION);
    const uint32_t commit = read_word(port, index, EIT_SLOT_COMMIT);

    port->storage_read(port->ctx, index, 0, blob, sizeof blob);
    slot->valid = false;
    slot->confirmed = false;
    slot->tried = read_word(port, index, EIT_SLOT_ATTEMPT) != ERASED;
    slot->generation = 0;
    if (eit_config_read(blob, sizeof blob, &slot->config) != EIT_OK ||
        commit != commit_word(slot->config.digest, generation)) {
        return;
    }
    slot->generation = generation;
    slot->valid = read_word(port, index, EIT_SLOT_REVOKED) == ERASED;
    slot->confirmed = slot->valid && read_word(port, index, EIT_SLOT_CONFIRM) == ~commit;
}

static void run(struct eit_store *store, uint8_t index, const struct slot *slot, struct eit_config *config)
{
    store->active = index;
    store->generation = slot->generation;
    *config = slot->config;
}

void eit_store_boot(struct eit_store *store, const struct eit_port *port, struct eit_config *config)
{
    struct slot slots[2];
    uint8_t newer;
    uint8_t older;

    store->port = port;
    store->active = EIT_NO_SLOT;
    store->trial = false;
    store->gave_up = false;
    store->generation = 0;
    store->written = 0;
    inspect(port, 0, &slots[0]);
    inspect(port, 1, &slots[1]);
    newer = slots[1].valid && (!slots[0].valid || slots[1].generation > slots[0].generation);
    older = (uint8_t)(1u - newer);
    store->next_generation =
        1u + (slots[0].generation > slots[1].generation ? slots[0].generation : slots[1].generation);
    if (slots[newer].confirmed) {
        run(store, newer, &slots[newer], config);
        return;
    }
    if (slots[newer].valid) {
        /* On trial for this one boot; if even the mark cannot be made, it must not run, or it would run for ever. */
        if (!slots[newer].tried && program(port, newer, EIT_SLOT_ATTEMPT, 0) == EIT_OK) {
            store->trial = true;
            run(store, newer, &slots[newer], config);
            return;
        }
        store->gave_up = true;
    }
    if (slots[older].confirmed) {
        run(store, older, &slots[older], config);
        return;
    }
    eit_config_factory(config);
}

uint8_t eit_store_other(const struct eit_store *store)
{
    return store->active == 0 ? 1 : 0;
}

bool eit_store_is_revoked(const struct eit_store *store)
{
    return store->active != EIT_NO_SLOT && read_word(store->port, store->active, EIT_SLOT_REVOKED) != ERASED;
}

/* Storage is asked, not memory: what runs may have been revoked, or its slot may have decayed, since the boot. */
bool eit_store_may_begin(const struct eit_store *store)
{
    struct slot slot;

    if (store->trial) {
        return false;
    }
    inspect(store->port, eit_store_other(store), &slot);
    if (!slot.confirmed) {
        return true; /* there is nothing to lose */
    }
    if (store->active == EIT_NO_SLOT) {
        return false;
    }
    inspect(store->port, store->active, &slot);
    return slot.confirmed;
}

enum eit_status eit_store_begin(struct eit_store *store)
{
    const uint8_t other = eit_store_other(store);
    enum eit_status status;

    /* An erase cut short may set some words and not others; without a commit word the slot cannot come back to life. */
    status = program(store->port, other, EIT_SLOT_COMMIT, 0);
    if (status == EIT_OK) {
        status = store->port->storage_erase(store->port->ctx, other);
    }
    if (status != EIT_OK) {
        return status;
    }
    store->written = 0;
    for (uint32_t offset = 0; offset < EIT_SLOT_BYTES; offset += 4u) {
        if (read_word(store->port, other, offset) != ERASED) {
            return EIT_STORAGE;
        }
    }
    return EIT_OK;
}

enum eit_status eit_store_write(struct eit_store *store, const uint8_t *data, uint32_t length)
{
    const uint8_t other = eit_store_other(store);

    if (length % 4u != 0 || length > EIT_CONFIG_BYTES - store->written) {
        return EIT_VALUE;
    }
    for (uint32_t at = 0; at < length; at += 4u) {
        const enum eit_status status = program(store->port, other, store->written + at, eit_get32(data + at));

        if (status != EIT_OK) {
            return status;
        }
    }
    store->written += length;
    return EIT_OK;
}

enum eit_status eit_store_verify(const struct eit_store *store, struct eit_config *config)
{
    uint8_t blob[EIT_CONFIG_BYTES];

    store->port->storage_read(store->port->ctx, eit_store_other(store), 0, blob, sizeof blob);
    return eit_config_read(blob, sizeof blob, config);
}

enum eit_status eit_store_commit(struct eit_store *store, uint32_t digest, uint32_t *generation)
{
    const uint8_t other = eit_store_other(store);
    enum eit_status status = program(store->port, other, EIT_SLOT_GENERATION, store->next_generation);

    if (status == EIT_OK) {
        status = program(store->port, other, EIT_SLOT_COMMIT, commit_word(digest, store->next_generation));
    }
    if (status != EIT_OK) {
        return status;
    }
    *generation = store->next_generation;
    store->next_generation++;
    return EIT_OK;
}

enum eit_status eit_store_confirm(struct eit_store *store)
{
    enum eit_status status;

    if (!store->trial) {
        return EIT_OK;
    }
    status = program(store->port, store->active, EIT_SLOT_CONFIRM,
                     ~read_word(store->port, store->active, EIT_SLOT_COMMIT));
    if (status == EIT_OK) {
        store->trial = false;
    }
    return status;
}

enum eit_status eit_store_revoke(struct eit_store *store)
{
    struct slot slot;

    inspect(store->port, eit_store_other(store), &slot);
    if (store->active == EIT_NO_SLOT || !slot.confirmed) {
        return EIT_EMPTY;
    }
    if (eit_store_is_revoked(store)) {
        return EIT_OK;
    }
    return program(store->port, store->active, EIT_SLOT_REVOKED, 0);
}

enum eit_status eit_store_read(const struct eit_store *store, uint8_t slot, uint8_t blob[EIT_CONFIG_BYTES],
                               uint32_t *generation)
{
    struct slot found;

    inspect(store->port, slot, &found);
    if (!found.valid) {
        return EIT_EMPTY;
    }
    *generation = found.generation;
    store->port->storage_read(store->port->ctx, slot, 0, blob, EIT_CONFIG_BYTES);
    return EIT_OK;
}
