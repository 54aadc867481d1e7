/* What the device does with an intact payload from the host. */
#ifndef EIT_REQUEST_H
#define EIT_REQUEST_H

#include <stddef.h>
#include <stdint.h>

#include "eit_device.h"

/* Check the payload, act, and answer. `now_us` is the present time of the device's clock. */
void eit_request_handle(struct eit_device *device, const uint8_t *payload, size_t length, uint32_t now_us);

#endif
