/* The device: answers requests, streams frames at the configuration's rate, keeps the configuration's lock and trial.
 *
 * A board calls eit_device_boot() once, then eit_device_receive() with what the line brought and eit_device_poll()
 * again and again; eit_device_idle_us() says how long it may sleep. All state is in struct eit_device, which the
 * board owns. */
#ifndef EIT_DEVICE_H
#define EIT_DEVICE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "eit_config.h"
#include "eit_framing.h"
#include "eit_message.h"
#include "eit_port.h"
#include "eit_scan.h"
#include "eit_store.h"

#define EIT_LOCK_US 10000000u    /* silence after which a flashing session loses its lock */
#define EIT_TRIAL_US 30000000u   /* time for CONFIG_CONFIRM before the device goes back by itself */
#define EIT_RESTART_US 20000u    /* between the answer to RESTART and the restart, so that the answer leaves */

/* What a device says about itself. */
struct eit_identity {
    uint8_t serial_number[16];   /* ASCII, padded with zeros */
    uint8_t firmware_version[3];
    uint32_t line_bytes_per_s;   /* 0 if unknown */
};

struct eit_device {
    const struct eit_port *port;
    const struct eit_identity *identity;
    struct eit_store store;
    struct eit_config config;    /* the active one */
    struct eit_deframer deframer;
    struct eit_scan scan;
    uint64_t uptime_us;
    uint32_t last_us;            /* of the clock, to add up uptime */
    /* streaming */
    bool streaming;
    bool idle;                   /* the idle mode is on */
    bool switched;               /* it was switched on or off since the last scan began */
    bool idle_scan;              /* the present scan is one of the idle mode */
    bool scanning;               /* a scan has begun */
    bool first;                  /* the next frame is the first after START */
    bool overrun_reported;
    uint32_t frames_left;        /* 0: no limit */
    uint32_t sequence;           /* of the next scan */
    uint16_t dropped;
    uint32_t next_us;            /* when the next scan is due */
    uint32_t remainder;          /* of the period, in units of 1 / rate us */
    /* flashing */
    uint32_t token;              /* of the session that holds the lock; 0: none */
    uint32_t token_us;           /* when it was last heard */
    bool begun;                  /* the other slot is being written */
    uint32_t begun_digest;       /* what CONFIG_BEGIN announced */
    uint32_t committed_generation; /* of what this session committed; 0: nothing yet */
    bool restarting;
    uint32_t restart_us;
    bool leaving;                /* the event before the restart was sent */
    bool announced;              /* the event after boot was sent */
    /* memory for packets */
    uint8_t received[EIT_MAX_REQUEST_BYTES + EIT_CRC_BYTES];
    uint8_t payload[EIT_MAX_FRAME_BYTES];
    uint8_t reply[EIT_HELLO_BYTES];
    uint8_t packet[EIT_PACKET_BYTES(EIT_MAX_FRAME_BYTES)];
};

void eit_device_boot(struct eit_device *device, const struct eit_port *port, const struct eit_identity *identity);
void eit_device_receive(struct eit_device *device, const uint8_t *data, size_t length);
void eit_device_poll(struct eit_device *device);

/* Microseconds until eit_device_poll() has something to do; at most 10000. */
uint32_t eit_device_idle_us(const struct eit_device *device);

#endif
