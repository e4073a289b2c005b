/* Motor bench: the time between two blade passages at an optocoupler, for the debug field.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef BLADE_TIMER_H
#define BLADE_TIMER_H

#include <stdint.h>

/* Ticks of 73/72 us. A blade in 250 us is 2000 rev/s, more than any motor of a craft this size:
 * a shorter interval is the same edge seen twice. */
#define BLADE_SHORTEST_TICKS 247u

typedef struct {
    volatile uint32_t half_turn; /* the newest interval: half a revolution of two blades, 0: none */
    uint32_t last;
    uint8_t seen;
} blade_timer;

/* At each falling edge, with a free-running 32-bit count of ticks. */
void blade_timer_edge(blade_timer *self, uint32_t now);

#endif
