/* SPDX-License-Identifier: Apache-2.0 */
#include "queue.h"

#include <stdatomic.h>
#include <string.h>

void queue_init(queue *self, bool forward_copies)
{
    memset(self, 0, sizeof *self);
    self->forward_copies = forward_copies;
}

void queue_put(queue *self, const uint8_t packet[GROUNDSTATION_PACKET_BYTES])
{
    const uint32_t waiting = self->written - self->read;
    const bool is_copy =
        self->has_newest && memcmp(self->newest, packet, GROUNDSTATION_PACKET_BYTES) == 0;

    if (is_copy && (!self->forward_copies || waiting > QUEUE_ALL_COPIES)) {
        self->copies_left_out++;
        return;
    }
    if (waiting >= QUEUE_PACKETS) {
        self->dropped++;
        return;
    }
    memcpy(self->newest, packet, GROUNDSTATION_PACKET_BYTES);
    self->has_newest = true;
    memcpy(self->packets[self->written % QUEUE_PACKETS], packet, GROUNDSTATION_PACKET_BYTES);
    atomic_signal_fence(memory_order_release); /* its content first: an interrupt may read now */
    self->written++;
}

uint8_t queue_take_frame(queue *self, uint8_t frame[GROUNDSTATION_USB_FRAME_BYTES])
{
    uint8_t length = 0;

    while (length < GROUNDSTATION_USB_FRAME_BYTES && self->read != self->written) {
        const uint8_t *oldest = self->packets[self->read % QUEUE_PACKETS];
        memcpy(frame + length, oldest, GROUNDSTATION_PACKET_BYTES);
        length = (uint8_t)(length + GROUNDSTATION_PACKET_BYTES);
        atomic_signal_fence(memory_order_release);
        self->read++;
    }
    return length;
}

void queue_clear(queue *self)
{
    self->read = self->written;
}
