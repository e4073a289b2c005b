/* The bridge: telemetry packets from the radio into isochronous USB frames.
 * SPDX-License-Identifier: Apache-2.0
 */
#include "board.h"
#include "nrf24.h"
#include "queue.h"
#include "usb.h"

#ifndef FORWARD_COPIES
#define FORWARD_COPIES true /* false: only what differs from the packet before, as in the thesis */
#endif
enum { LOOK_US = 100000 };

static const nrf24_air AIR = NRF24_DEFAULT_AIR;
static queue packets;
static volatile uint32_t received;

static void take_all(void)
{
    uint8_t packet[GROUNDSTATION_PACKET_BYTES];

    while (nrf24_receive(&board_radio, packet)) {
        queue_put(&packets, packet);
        received++;
    }
}

void radio_interrupt(void);
void radio_interrupt(void)
{
    board_radio_interrupt_seen(); /* first: an edge from here on counts again */
    take_all();
}

int main(void)
{
    uint32_t seen = 0;

    board_init();
    queue_init(&packets, FORWARD_COPIES);
    usb_start(&packets); /* the host sees the bridge even where the radio is missing */
    board_wait_us(NRF24_POWER_ON_US);
    for (;;) { /* ten times a second: is the radio still there, was an edge missed */
        board_radio_interrupt(false);
        const bool missing = !nrf24_is_set(&board_radio, &AIR);
        if (missing)
            nrf24_start_receiver(&board_radio, &AIR);
        else
            take_all();
        board_radio_interrupt(true);
        board_lights(received != seen, missing);
        seen = received;
        board_wait_us(LOOK_US);
    }
}
