/* The core peripherals used here: ARMv7-M Architecture Reference Manual, B3.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORTEX_M_H
#define CORTEX_M_H

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(uintptr_t)(address))

#define DEMCR REGISTER(0xE000EDFCu)
#define DEMCR_TRCENA (1u << 24)
#define DWT_CTRL REGISTER(0xE0001000u)
#define DWT_CTRL_CYCCNTENA (1u << 0)
#define DWT_CYCCNT REGISTER(0xE0001004u)

static inline void interrupt_enable(uint32_t number)
{
    REGISTER(0xE000E100u + 4 * (number / 32)) = 1u << (number % 32);
}

/* Off when this returns; what comes meanwhile waits. */
static inline void interrupt_disable(uint32_t number)
{
    REGISTER(0xE000E180u + 4 * (number / 32)) = 1u << (number % 32);
    __asm volatile("dsb\n\tisb" ::: "memory");
}

/* priority: 0 is the highest; the upper four bits count on an STM32. */
static inline void interrupt_priority(uint32_t number, uint8_t priority)
{
    ((volatile uint8_t *)(uintptr_t)0xE000E400u)[number] = (uint8_t)(priority << 4);
}

static inline void cycles_start(void)
{
    DEMCR |= DEMCR_TRCENA;
    DWT_CTRL |= DWT_CTRL_CYCCNTENA;
}

static inline void cycles_wait(uint32_t cycles)
{
    const uint32_t begun = DWT_CYCCNT;
    while (DWT_CYCCNT - begun < cycles) {
    }
}

#endif
