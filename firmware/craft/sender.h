/* The craft's side: what a control loop knows as a telemetry packet, sent four times.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SENDER_H
#define SENDER_H

#include <stdbool.h>
#include <stdint.h>

#include "groundstation_telemetry.h"
#include "nrf24.h"

#define SENDER_COPIES 4u      /* of each packet */
#define SENDER_PERIOD_US 500u /* from one to the next: `sender_tick` */

/* One pass of the control loop, in the units a Crazyflie's firmware has at hand. */
typedef struct {
    uint16_t ticks;           /* timer of 73/72 us a tick, at the gyro sample */
    float battery_v;
    uint16_t motor_ratio[4];  /* 16 bits, M1 first: what acted over the 2 ms before the sample */
    int16_t gyro[3];          /* registers, +-2000 deg/s; x forward, y left, z up */
    int16_t accelerometer[3]; /* registers, +-8 g */
    float roll_deg, pitch_deg, yaw_deg; /* pitch nose up positive */
    uint32_t debug;           /* on the motor bench `blade_timer`'s result */
} sender_sample;

/* The packet of a sample. What does not fit a field is held at its limit. */
void sender_pack(groundstation_packet *packet, const sender_sample *sample);

/* Two packets: one being sent, one being filled. `sender_publish` is called by the control loop,
 * `sender_tick` by an interrupt or task of higher priority. */
typedef struct {
    groundstation_packet packets[2];
    volatile uint8_t latest;    /* which of the two is whole */
    volatile uint8_t published; /* counts packets, modulo 256 */
    uint8_t seen, copies, next_register;
    uint16_t ticks;
} sender;

void sender_init(sender *self);
void sender_publish(sender *self, const sender_sample *sample);

/* Every 500 us: sends the newest packet unless it went out four times; whether it sent. Ten times
 * a second it writes one setting of the radio again instead. A loop that hangs is therefore a
 * silence, never an old packet again and again. */
bool sender_tick(sender *self, const nrf24_bus *bus, const nrf24_air *air);

#endif
