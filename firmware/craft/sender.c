/* SPDX-License-Identifier: Apache-2.0 */
#include "sender.h"

#include <stdatomic.h>
#include <string.h>

enum { TICKS_A_REFRESH = 200 };

static int32_t rounded(float value, float low, float high)
{
    if (!(value > low)) /* not a number counts as low */
        return (int32_t)low;
    if (value > high)
        return (int32_t)high;
    return (int32_t)(value < 0.0f ? value - 0.5f : value + 0.5f);
}

static int16_t hundredths(float degrees)
{
    return (int16_t)rounded(100.0f * degrees, -32768.0f, 32767.0f);
}

void sender_pack(groundstation_packet *packet, const sender_sample *sample)
{
    uint16_t motors[4];

    for (int i = 0; i < 4; i++) /* the timer compares nine bits: twelve with three zeros */
        motors[i] = (uint16_t)((sample->motor_ratio[i] >> 7) << 3);
    packet->timestamp = sample->ticks;
    packet->battery = (uint16_t)rounded(1000.0f * sample->battery_v, 0.0f, 65535.0f);
    groundstation_pack_motors(packet->motors, motors);
    memcpy(packet->gyro, sample->gyro, sizeof packet->gyro);
    memcpy(packet->accelerometer, sample->accelerometer, sizeof packet->accelerometer);
    packet->angles[0] = hundredths(sample->roll_deg);
    packet->angles[1] = hundredths(sample->pitch_deg);
    packet->angles[2] = hundredths(sample->yaw_deg);
    packet->debug = sample->debug;
}

void sender_init(sender *self)
{
    memset(self, 0, sizeof *self);
    self->copies = SENDER_COPIES;
}

void sender_publish(sender *self, const sender_sample *sample)
{
    const uint8_t other = self->latest ^ 1u;

    sender_pack(&self->packets[other], sample);
    atomic_signal_fence(memory_order_release);
    self->latest = other; /* one byte: a tick sees the packet whole or not at all */
    self->published++;
}

bool sender_tick(sender *self, const nrf24_bus *bus, const nrf24_air *air)
{
    const uint8_t published = self->published;

    if (published != self->seen) {
        self->seen = published;
        self->copies = 0;
    }
    if (++self->ticks >= TICKS_A_REFRESH) {
        self->ticks = 0;
        nrf24_refresh_transmitter(bus, air, &self->next_register);
        return false;
    }
    if (self->copies >= SENDER_COPIES)
        return false;
    nrf24_send(bus, (const uint8_t *)&self->packets[self->latest]);
    self->copies++;
    return true;
}
