/* SPDX-License-Identifier: Apache-2.0 */
#include "blade_timer.h"

void blade_timer_edge(blade_timer *self, uint32_t now)
{
    const uint32_t interval = now - self->last; /* wraps as the counter does */

    if (self->seen && interval < BLADE_SHORTEST_TICKS)
        return;
    if (self->seen)
        self->half_turn = interval;
    self->seen = 1;
    self->last = now;
}
