/* SPDX-License-Identifier: Apache-2.0 */
#include "nrf24.h"

#include <stddef.h>
#include <string.h>

enum { /* commands, table 20 */
    READ_REGISTER = 0x00,
    WRITE_REGISTER = 0x20,
    READ_PAYLOAD = 0x61,
    WRITE_PAYLOAD = 0xA0,
    FLUSH_TX = 0xE1,
    FLUSH_RX = 0xE2
};

enum { /* registers, table 28 */
    CONFIG = 0x00,
    EN_AA = 0x01,
    EN_RXADDR = 0x02,
    SETUP_AW = 0x03,
    SETUP_RETR = 0x04,
    RF_CH = 0x05,
    RF_SETUP = 0x06,
    STATUS = 0x07,
    RX_ADDR_P0 = 0x0A,
    TX_ADDR = 0x10,
    RX_PW_P0 = 0x11,
    FIFO_STATUS = 0x17,
    DYNPD = 0x1C,
    FEATURE = 0x1D
};

enum {
    MASK_TX_AND_RETRIES = 0x30, /* IRQ for received packets only */
    CRC_TWO_BYTES = 0x0C,
    POWER_UP = 0x02,
    RECEIVER = 0x01,
    RATE_2M_POWER_0DBM = 0x0E,
    ALL_EVENTS = 0x70,
    RECEIVED = 0x40,
    RX_EMPTY = 0x01
};

static const uint8_t TRANSMITTER_CONFIG = MASK_TX_AND_RETRIES | CRC_TWO_BYTES | POWER_UP;
static const uint8_t RECEIVER_CONFIG = MASK_TX_AND_RETRIES | CRC_TWO_BYTES | POWER_UP | RECEIVER;

/* The same at both ends, in the order in which they are written. */
static const uint8_t COMMON[][2] = {
    { EN_AA, 0x00 },      { SETUP_RETR, 0x00 }, { SETUP_AW, NRF24_ADDRESS_BYTES - 2 },
    { EN_RXADDR, 0x01 },  { RF_SETUP, RATE_2M_POWER_0DBM },
    { DYNPD, 0x00 },      { FEATURE, 0x00 },
};
enum { COMMON_COUNT = sizeof COMMON / sizeof COMMON[0] };

static void command(const nrf24_bus *bus, uint8_t code)
{
    bus->transfer(bus->board, &code, NULL, 1);
}

static void write_register(const nrf24_bus *bus, uint8_t number, uint8_t value)
{
    const uint8_t out[2] = { (uint8_t)(WRITE_REGISTER | number), value };
    bus->transfer(bus->board, out, NULL, sizeof out);
}

static uint8_t read_register(const nrf24_bus *bus, uint8_t number)
{
    const uint8_t out[2] = { (uint8_t)(READ_REGISTER | number), 0 };
    uint8_t in[2] = { 0, 0 };
    bus->transfer(bus->board, out, in, sizeof out);
    return in[1];
}

static void write_address(const nrf24_bus *bus, uint8_t number, const nrf24_air *air)
{
    uint8_t out[1 + NRF24_ADDRESS_BYTES];
    out[0] = (uint8_t)(WRITE_REGISTER | number);
    memcpy(out + 1, air->address, NRF24_ADDRESS_BYTES);
    bus->transfer(bus->board, out, NULL, sizeof out);
}

static void set_up(const nrf24_bus *bus, const nrf24_air *air)
{
    bus->enable(bus->board, false);
    for (int i = 0; i < COMMON_COUNT; i++)
        write_register(bus, COMMON[i][0], COMMON[i][1]);
    write_register(bus, RF_CH, air->channel);
    command(bus, FLUSH_TX);
    command(bus, FLUSH_RX);
    write_register(bus, STATUS, ALL_EVENTS);
}

void nrf24_start_transmitter(const nrf24_bus *bus, const nrf24_air *air)
{
    set_up(bus, air);
    write_address(bus, TX_ADDR, air);
    write_register(bus, CONFIG, TRANSMITTER_CONFIG);
    bus->wait_us(bus->board, NRF24_START_UP_US);
}

void nrf24_start_receiver(const nrf24_bus *bus, const nrf24_air *air)
{
    set_up(bus, air);
    write_address(bus, RX_ADDR_P0, air);
    write_register(bus, RX_PW_P0, NRF24_PAYLOAD_BYTES);
    write_register(bus, CONFIG, RECEIVER_CONFIG);
    bus->wait_us(bus->board, NRF24_START_UP_US);
    bus->enable(bus->board, true);
}

bool nrf24_is_set(const nrf24_bus *bus, const nrf24_air *air)
{
    const uint8_t config = read_register(bus, CONFIG);
    return (config == TRANSMITTER_CONFIG || config == RECEIVER_CONFIG)
        && read_register(bus, RF_CH) == air->channel
        && read_register(bus, RF_SETUP) == RATE_2M_POWER_0DBM;
}

void nrf24_refresh_transmitter(const nrf24_bus *bus, const nrf24_air *air, uint8_t *next)
{
    const uint8_t at = *next;
    if (at < COMMON_COUNT)
        write_register(bus, COMMON[at][0], COMMON[at][1]);
    else if (at == COMMON_COUNT) {
        write_register(bus, RF_CH, air->channel);
        write_address(bus, TX_ADDR, air);
    } else
        write_register(bus, CONFIG, TRANSMITTER_CONFIG);
    *next = at > COMMON_COUNT ? 0 : (uint8_t)(at + 1);
}

void nrf24_send(const nrf24_bus *bus, const uint8_t payload[NRF24_PAYLOAD_BYTES])
{
    uint8_t out[1 + NRF24_PAYLOAD_BYTES];
    out[0] = WRITE_PAYLOAD;
    memcpy(out + 1, payload, NRF24_PAYLOAD_BYTES);
    command(bus, FLUSH_TX); /* a full queue would never empty itself, and nobody could see it */
    bus->transfer(bus->board, out, NULL, sizeof out);
    bus->enable(bus->board, true);
    bus->wait_us(bus->board, 12); /* at least 10 us, figure 6.1.6 */
    bus->enable(bus->board, false);
}

bool nrf24_receive(const nrf24_bus *bus, uint8_t payload[NRF24_PAYLOAD_BYTES])
{
    uint8_t out[1 + NRF24_PAYLOAD_BYTES] = { READ_PAYLOAD };
    uint8_t in[1 + NRF24_PAYLOAD_BYTES] = { 0 };

    if (read_register(bus, FIFO_STATUS) & RX_EMPTY) {
        /* Release IRQ first and look again: what came in between raises it anew. */
        write_register(bus, STATUS, RECEIVED);
        if (read_register(bus, FIFO_STATUS) & RX_EMPTY)
            return false;
    }
    bus->transfer(bus->board, out, in, sizeof out);
    memcpy(payload, in + 1, NRF24_PAYLOAD_BYTES);
    return true;
}
