/* What the device sends apart from frames. Each function packs one message and queues it; a message that finds no
 * room on the line is lost, and the host asks again. */
#ifndef EIT_REPLY_H
#define EIT_REPLY_H

#include <stdint.h>

#include "eit_device.h"

void eit_reply_hello(struct eit_device *device, uint8_t tag);
void eit_reply_ack(struct eit_device *device, const uint8_t *request, uint8_t code, uint32_t detail);
void eit_reply_time(struct eit_device *device, uint8_t tag, uint32_t now_us);
void eit_reply_event(struct eit_device *device, uint8_t code, uint32_t now_us, uint32_t detail);

/* `length` bytes at `offset` of a blob; the caller has checked that they are inside. */
void eit_reply_config_data(struct eit_device *device, uint8_t tag, uint8_t slot, uint32_t generation,
                           const uint8_t *blob, uint16_t offset, uint8_t length);

/* Queue the packet of any payload; false if the line has no room. */
bool eit_reply_send(struct eit_device *device, const uint8_t *payload, size_t length);

#endif
