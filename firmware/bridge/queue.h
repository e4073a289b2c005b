/* Packets from the radio on their way to USB frames.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef QUEUE_H
#define QUEUE_H

#include <stdbool.h>
#include <stdint.h>

#include "groundstation_telemetry.h"

#define QUEUE_PACKETS 32u  /* a power of two; 16 ms at every copy of 500 packets/s */
#define QUEUE_ALL_COPIES 8u /* with more than this waiting, a copy of the newest is left out */

/* One writer (the radio's interrupt) and one reader (USB's), which may interrupt each other. */
typedef struct {
    uint8_t packets[QUEUE_PACKETS][GROUNDSTATION_PACKET_BYTES];
    volatile uint32_t written, read; /* packets so far, modulo 2^32 */
    uint8_t newest[GROUNDSTATION_PACKET_BYTES];
    bool has_newest, forward_copies;
    uint32_t copies_left_out, dropped; /* counts, for a debugger */
} queue;

/* forward_copies: pass on every copy (the station then counts loss and outvotes damage), or only
 * what differs from the packet before, as the thesis did (section 5.5.1). */
void queue_init(queue *self, bool forward_copies);

/* A packet from the radio. The bus carries 2000 packets/s by its own clock and the craft sends
 * 2000/s by its: where the craft is faster the queue would be full for ever, so copies of the
 * newest packet are left out while it is a quarter full. A full queue drops new packets. */
void queue_put(queue *self, const uint8_t packet[GROUNDSTATION_PACKET_BYTES]);

/* The content of the next USB frame: up to two packets; its length in bytes, 0, 32 or 64. */
uint8_t queue_take_frame(queue *self, uint8_t frame[GROUNDSTATION_USB_FRAME_BYTES]);

/* What waits is forgotten: nobody listened. */
void queue_clear(queue *self);

#endif
