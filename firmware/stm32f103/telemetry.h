/* Telemetry for the firmware of a Crazyflie 1.0 (STM32F103 at 72 MHz): link libtelemetry.a, start
 * it once the clocks run, publish a sample in each pass of the control loop.
 *
 * The thesis does not say which four pins of the expansion header it used. These are of SPI 2:
 * compare with the header of your board.
 *
 * | nRF24L01+ | pin | | pin |
 * |---|---|---|---|
 * | SCK | PB13 | CE | PB14 |
 * | MOSI | PB15 | CS (CSN) | PB12 |
 * | MISO, IRQ | not wired | optocoupler (motor bench) | PA0 |
 *
 * Taken: SPI 2, timers 2 (the time stamp) and 3 (500 us), EXTI 0 on the motor bench, the cycle
 * counter. The vectors TIM3 and EXTI0 must call the functions below.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef STM32F103_TELEMETRY_H
#define STM32F103_TELEMETRY_H

#include <stdint.h>

#include "sender.h"

/* Blocks for 105 ms while the radio starts. */
void telemetry_start(const nrf24_air *air);

/* The time stamp of `sender_sample`: read it with the gyro. */
uint16_t telemetry_ticks(void);

/* Hand over the newest sample, every 2 ms. Its `debug` is filled in on the motor bench. */
void telemetry_publish(const sender_sample *sample);

/* Motor bench: the debug field becomes the time of half a revolution. */
void telemetry_watch_blades(void);

void telemetry_send_interrupt(void);  /* vector TIM3 */
void telemetry_blade_interrupt(void); /* vector EXTI0 */

#endif
