/* SPDX-License-Identifier: Apache-2.0 */
#include <stdint.h>

#include "registers.h"
#include "start.h"
#include "usb.h"

extern uint32_t stack_top;

void radio_interrupt(void);

typedef void (*vector)(void);

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    vector exceptions[15];
    vector interrupts[IRQ_COUNT];
} vectors = {
    &stack_top,
    { start_reset, start_stop, start_stop, start_stop, start_stop, start_stop },
    { [IRQ_EXTI1] = radio_interrupt, [IRQ_OTG_FS] = usb_interrupt },
};
