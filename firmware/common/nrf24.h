/* nRF24L01+ transceiver: 32-byte payloads at 2 Mbit/s, no acknowledgement.
 * Source: Nordic Semiconductor, nRF24L01+ Product Specification 1.0.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef NRF24_H
#define NRF24_H

#include <stdbool.h>
#include <stdint.h>

#define NRF24_PAYLOAD_BYTES 32
#define NRF24_ADDRESS_BYTES 5
#define NRF24_POWER_ON_US 100000u /* table 16: from supply to the first SPI access */
#define NRF24_START_UP_US 5000u   /* table 16: crystal start-up, any of the usual crystals */

/* What the board gives. `transfer` is one SPI transaction, chip select included (mode 0, at most
 * 10 MHz): `out` is sent while `in` is received. `in` may be NULL; it holds nothing of use where
 * MISO is not wired. */
typedef struct {
    void (*transfer)(void *board, const uint8_t *out, uint8_t *in, uint8_t size);
    void (*enable)(void *board, bool high); /* the CE pin */
    void (*wait_us)(void *board, uint32_t us);
    void *board;
} nrf24_bus;

typedef struct {
    uint8_t channel; /* 2400 + channel MHz, at most 81 to stay below 2483.5 MHz at 2 Mbit/s */
    uint8_t address[NRF24_ADDRESS_BYTES]; /* lowest byte first */
} nrf24_air;

/* Where both ends meet unless a board says otherwise. Crazyradio uses channel 10 or 80 and
 * address E7E7E7E7E7 from the factory: telemetry keeps away from both. */
#define NRF24_DEFAULT_AIR { 60, { 0x31, 0x4C, 0x54, 0x53, 0x47 } }

/* Power up as transmitter or receiver. Blocks for NRF24_START_UP_US. The transmitter reads nothing
 * back, so three wires and CE are enough. */
void nrf24_start_transmitter(const nrf24_bus *bus, const nrf24_air *air);
void nrf24_start_receiver(const nrf24_bus *bus, const nrf24_air *air);

/* Whether the chip holds the settings that were written: false for no chip, a wire that is not
 * connected, or a supply that dropped. Needs MISO. */
bool nrf24_is_set(const nrf24_bus *bus, const nrf24_air *air);

/* Write one register again that a module loses when its supply drops, another with each call: 9
 * calls restore all of them. For a transmitter that cannot be asked. */
void nrf24_refresh_transmitter(const nrf24_bus *bus, const nrf24_air *air, uint8_t *next);

/* Put one payload on the air: 130 us to settle and 165 us to send, after this has returned. What
 * an earlier call left behind is discarded. */
void nrf24_send(const nrf24_bus *bus, const uint8_t payload[NRF24_PAYLOAD_BYTES]);

/* The oldest payload received, false when there is none. The IRQ pin is released with the last. */
bool nrf24_receive(const nrf24_bus *bus, uint8_t payload[NRF24_PAYLOAD_BYTES]);

#endif
