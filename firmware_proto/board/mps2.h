/* What the parts of the emulated board share: its memory, its clock, and the front end's functions of eit_port. */
#ifndef MPS2_H
#define MPS2_H

#include "eit_device.h"

#define MPS2_PSRAM 0x21000000u

uint32_t mps2_now_us(void *ctx);

/* The clock shows no less than this from now on. */
void mps2_settle_until(uint32_t moment_us);

enum eit_status mps2_drive(void *ctx, uint8_t number, const struct eit_config *config);
enum eit_status mps2_measure(void *ctx, const struct eit_config *config, int32_t counts[EIT_PAIRS],
                             uint16_t *saturated);
double mps2_volts_per_count(void *ctx, const struct eit_config *config);

#endif
