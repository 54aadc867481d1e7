#include "eit_device.h"

#include "eit_flash.h"
#include "eit_reply.h"
#include "eit_request.h"

#define MAX_IDLE_US 10000u

static uint32_t clock_us(struct eit_device *device)
{
    const uint32_t now_us = device->port->now_us(device->port->ctx);

    device->uptime_us += now_us - device->last_us;
    device->last_us = now_us;
    return now_us;
}

void eit_device_boot(struct eit_device *device, const struct eit_port *port, const struct eit_identity *identity)
{
    device->port = port;
    device->identity = identity;
    device->uptime_us = 0;
    device->last_us = port->now_us(port->ctx);
    device->streaming = false;
    device->idle = false;
    device->switched = false;
    device->idle_scan = false;
    device->scanning = false;
    device->first = false;
    device->overrun_reported = false;
    device->frames_left = 0;
    device->sequence = 0;
    device->dropped = 0;
    device->next_us = 0;
    device->remainder = 0;
    device->token = 0;
    device->token_us = 0;
    device->begun = false;
    device->begun_digest = 0;
    device->committed_generation = 0;
    device->restarting = false;
    device->restart_us = 0;
    device->leaving = false;
    device->announced = false;
    eit_deframer_init(&device->deframer, device->received, sizeof device->received);
    eit_store_boot(&device->store, port, &device->config);
}

void eit_device_receive(struct eit_device *device, const uint8_t *data, size_t length)
{
    for (size_t i = 0; i < length; i++) {
        size_t payload_bytes;

        if (eit_deframer_push(&device->deframer, data[i], &payload_bytes) == EIT_OK && !device->restarting) {
            eit_request_handle(device, device->received, payload_bytes, clock_us(device));
        }
    }
}

static uint32_t rate_mHz(const struct eit_device *device)
{
    return device->idle ? device->config.idle_rate_mHz : device->config.rate_mHz;
}

/* One period is 1e9 / rate us; the remainder is carried along, so that no rate drifts. */
static void advance(struct eit_device *device)
{
    const uint32_t rate = rate_mHz(device);
    uint64_t remainder = (uint64_t)device->remainder + 1000000000u % rate;

    device->next_us += 1000000000u / rate;
    if (remainder >= rate) {
        device->next_us++;
        remainder -= rate;
    }
    device->remainder = (uint32_t)(remainder % rate); /* the mode, and with it the rate, may have changed */
}

static void count_dropped(struct eit_device *device)
{
    device->dropped = (uint16_t)(device->dropped + 1u); /* modulo 2^16: a host adds up the differences */
}

static void end_scan(struct eit_device *device)
{
    device->scanning = false;
    device->sequence++;
    if (device->frames_left != 0) {
        device->frames_left--;
        if (device->frames_left == 0) {
            device->streaming = false;
        }
    }
}

static void begin_scan(struct eit_device *device, uint32_t now_us)
{
    const uint32_t period_us = 1000000000u / rate_mHz(device);
    const uint16_t drives = device->idle ? device->config.idle_drives : device->config.drives;

    /* A scan that should have ended before now is given up and counted; its number is not given to another. */
    while ((int32_t)(now_us - device->next_us) >= (int32_t)period_us && device->streaming) {
        advance(device);
        count_dropped(device);
        end_scan(device);
        if (!device->overrun_reported) {
            device->overrun_reported = true;
            eit_reply_event(device, EIT_EVENT_OVERRUN, now_us, device->sequence - 1u);
        }
    }
    if (!device->streaming) {
        return;
    }
    advance(device);
    device->scanning = true;
    eit_scan_begin(&device->scan, &device->config, drives, device->payload, now_us);
    device->idle_scan = device->idle;
}

static void send_frame(struct eit_device *device, uint32_t now_us)
{
    struct eit_frame frame;
    unsigned flags = 0;

    flags |= eit_config_is_full(&device->config) ? EIT_FRAME_FLAG_FULL : 0u;
    flags |= device->idle_scan ? EIT_FRAME_FLAG_IDLE : 0u;
    flags |= device->first ? EIT_FRAME_FLAG_FIRST : 0u;
    flags |= device->store.trial ? EIT_FRAME_FLAG_TRIAL : 0u;
    frame.flags = (uint8_t)flags;
    frame.sample_bytes = device->config.sample_bytes;
    frame.rows = device->scan.total_rows;
    frame.generation = device->store.generation;
    frame.sequence = device->sequence;
    frame.device_us = now_us;
    frame.drives = device->scan.drives;
    frame.device_dropped = device->dropped;
    eit_frame_put_header(&frame, device->payload);
    if (eit_reply_send(device, device->payload, eit_frame_bytes(frame.rows, frame.sample_bytes))) {
        device->first = false;
    } else {
        count_dropped(device);
    }
}

static void stream(struct eit_device *device, uint32_t now_us)
{
    enum eit_status status;

    if (!device->streaming) {
        return;
    }
    if (!device->scanning) {
        if (device->switched) { /* the new mode begins now, not when the old one's next scan was due */
            device->switched = false;
            device->next_us = now_us;
            device->remainder = 0;
        }
        if ((int32_t)(now_us - device->next_us) < 0) {
            return;
        }
        begin_scan(device, now_us);
        if (!device->scanning) {
            return;
        }
    }
    status = eit_scan_step(&device->scan, device->port, now_us);
    if (status == EIT_AGAIN) {
        return;
    }
    if (status == EIT_OK) {
        send_frame(device, now_us);
    } else {
        count_dropped(device);
        eit_reply_event(device, EIT_EVENT_FRONT_END_FAILED, now_us, device->sequence);
    }
    end_scan(device);
}

static void announce(struct eit_device *device, uint32_t now_us)
{
    if (!device->announced) {
        device->announced = true;
        eit_reply_event(device, device->store.gave_up ? EIT_EVENT_ROLLED_BACK : EIT_EVENT_CONFIGURATION_CHANGED, now_us,
                        device->store.generation);
    }
}

void eit_device_poll(struct eit_device *device)
{
    const uint32_t now_us = clock_us(device);

    announce(device, now_us);
    (void)eit_flash_lock_ms(device, now_us); /* a lock expires even if nobody asks before the clock has come round */
    if (device->store.trial && device->uptime_us >= EIT_TRIAL_US && !device->restarting) {
        device->streaming = false;
        device->restarting = true;
        device->restart_us = now_us;
    }
    if (device->restarting) {
        if (!device->leaving) {
            device->leaving = true;
            eit_reply_event(device, EIT_EVENT_RESTARTING, now_us, device->store.generation);
        }
        if ((int32_t)(now_us - device->restart_us) >= 0) {
            device->port->restart(device->port->ctx);
        }
        return;
    }
    stream(device, now_us);
}

uint32_t eit_device_idle_us(const struct eit_device *device)
{
    uint32_t due_us = device->last_us + MAX_IDLE_US;
    uint32_t left_us;

    if (device->restarting) {
        due_us = device->restart_us;
    } else if (device->streaming && device->scanning) {
        due_us = device->scan.due_us;
    } else if (device->streaming) {
        due_us = device->switched ? device->last_us : device->next_us;
    }
    left_us = due_us - device->port->now_us(device->port->ctx);
    if ((int32_t)left_us <= 0) {
        return 0;
    }
    return left_us < MAX_IDLE_US ? left_us : MAX_IDLE_US;
}
