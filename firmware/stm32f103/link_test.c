/* A transmitter without a craft: packets 500 times a second, as a craft would send them at rest,
 * to try the radio and the bridge before any flight firmware is touched. Battery 0 mV, motors 0,
 * 1 g, the yaw angle turning by 90 deg/s; debug counts the packets.
 * SPDX-License-Identifier: Apache-2.0
 */
#include "registers.h"
#include "start.h"
#include "telemetry.h"

#ifndef CRYSTAL_MHZ
#define CRYSTAL_MHZ 16 /* Crazyflie 1.0; 8 on most other boards */
#endif
_Static_assert(CRYSTAL_MHZ == 8 || CRYSTAL_MHZ == 16, "72 MHz are made from 8 or 16");

enum { PERIOD_CYCLES = 144000, TURN_PACKETS = 2000, ONE_G = 4096 };

static void clocks(void)
{
    RCC_CR |= RCC_CR_HSEON;
    while (!(RCC_CR & RCC_CR_HSERDY)) {
    }
    FLASH_ACR = 1u << 4 | 2u; /* prefetch, two wait states */
    RCC_CFGR = RCC_CFGR_PLL_OF_HSE | RCC_CFGR_PLL_BY_9 | RCC_CFGR_APB1_HALVED
        | (CRYSTAL_MHZ == 16 ? RCC_CFGR_HSE_HALVED : 0);
    RCC_CR |= RCC_CR_PLLON;
    while (!(RCC_CR & RCC_CR_PLLRDY)) {
    }
    RCC_CFGR |= 2u;
    while ((RCC_CFGR >> 2 & 3u) != 2u) {
    }
}

int main(void)
{
    static const nrf24_air AIR = NRF24_DEFAULT_AIR;
    sender_sample sample = { .accelerometer = { 0, 0, ONE_G } };
    uint32_t due;

    clocks();
    telemetry_start(&AIR);
    due = DWT_CYCCNT;
    for (;;) {
        due += PERIOD_CYCLES;
        while ((int32_t)(DWT_CYCCNT - due) < 0) {
        }
        sample.ticks = telemetry_ticks();
        sample.yaw_deg = 0.18f * (float)(sample.debug % TURN_PACKETS) - 180.0f;
        telemetry_publish(&sample);
        sample.debug++;
    }
}

extern uint32_t stack_top;

typedef void (*vector)(void);

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    vector exceptions[15];
    vector interrupts[IRQ_COUNT];
} vectors = {
    &stack_top,
    { start_reset, start_stop, start_stop, start_stop, start_stop, start_stop },
    { [IRQ_EXTI0] = telemetry_blade_interrupt, [IRQ_TIM3] = telemetry_send_interrupt },
};
