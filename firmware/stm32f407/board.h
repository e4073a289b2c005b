/* The bridge's board: STM32F4-Discovery (STM32F407VG, crystal of 8 MHz), as in thesis 5.1.2.
 *
 * | nRF24L01+ | pin | nRF24L01+ | pin |
 * |---|---|---|---|
 * | SCK | PB13 | CS (CSN) | PB12 |
 * | MISO | PB14 | CE | PB11 |
 * | MOSI | PB15 | IRQ | PB1 |
 *
 * USB: PA11, PA12, the board's own micro-AB socket. LEDs: PD12 green, packets come in; PD14 red,
 * no answer from the radio.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef STM32F407_BOARD_H
#define STM32F407_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "nrf24.h"

extern const nrf24_bus board_radio;

/* 168 MHz from the crystal, 48 MHz for USB, pins, SPI. The radio's interrupt stays off. */
void board_init(void);
void board_wait_us(uint32_t us);
void board_lights(bool receiving, bool radio_missing);

/* The radio's IRQ pin: vector EXTI1. An edge while it is off is not lost: it counts when on. */
void board_radio_interrupt(bool on);
void board_radio_interrupt_seen(void);

#endif
