/* SPDX-License-Identifier: Apache-2.0 */
#include "telemetry.h"

#include <stdbool.h>

#include "blade_timer.h"
#include "registers.h"

enum { MHZ = 72 };
enum { BLADE_PIN = 0, CS_PIN = 12, SCK_PIN = 13, CE_PIN = 14, MOSI_PIN = 15 };
enum { INPUT = 0x4, OUTPUT = 0x3, ALTERNATE = 0xB }; /* CNF and MODE, 50 MHz */

static nrf24_air radio_air;
static sender telemetry;
static blade_timer blades;
static bool watching;
static uint32_t long_ticks; /* the 16-bit counter, carried on by each interrupt */

static void pin(uint32_t port, uint32_t number, uint32_t mode)
{
    const uint32_t shift = 4 * (number % 8);
    GPIO_CR(port, number) = (GPIO_CR(port, number) & ~(0xFu << shift)) | mode << shift;
}

static void write_pin(uint32_t number, bool high)
{
    GPIO_BSRR(GPIOB) = 1u << (high ? number : number + 16);
}

static void transfer(void *board, const uint8_t *out, uint8_t *in, uint8_t size)
{
    (void)board;
    (void)in; /* no MISO */
    write_pin(CS_PIN, false);
    for (uint8_t i = 0; i < size; i++) {
        while (!(SPI2_SR & SPI_SR_TXE)) {
        }
        SPI2_DR = out[i];
        while (!(SPI2_SR & SPI_SR_RXNE)) { /* the byte has gone */
        }
        (void)SPI2_DR;
    }
    write_pin(CS_PIN, true);
}

static void enable(void *board, bool high)
{
    (void)board;
    write_pin(CE_PIN, high);
}

static void wait_us(void *board, uint32_t us)
{
    (void)board;
    cycles_wait(us * MHZ);
}

static const nrf24_bus RADIO = { transfer, enable, wait_us, 0 };

static void start_timer(uint32_t timer, uint32_t divisor, uint32_t period, bool interrupts)
{
    TIM_PSC(timer) = divisor - 1;
    TIM_ARR(timer) = period - 1;
    TIM_EGR(timer) = TIM_EGR_UG;
    TIM_SR(timer) = 0;
    TIM_DIER(timer) = interrupts ? TIM_DIER_UIE : 0;
    TIM_CR1(timer) = TIM_CR1_CEN;
}

void telemetry_start(const nrf24_air *air)
{
    RCC_APB2ENR |= RCC_APB2ENR_AFIO | RCC_APB2ENR_GPIOA | RCC_APB2ENR_GPIOB;
    RCC_APB1ENR |= RCC_APB1ENR_TIM2 | RCC_APB1ENR_TIM3 | RCC_APB1ENR_SPI2;
    (void)RCC_APB1ENR;
    cycles_start();
    write_pin(CS_PIN, true);
    write_pin(CE_PIN, false);
    pin(GPIOB, CS_PIN, OUTPUT);
    pin(GPIOB, CE_PIN, OUTPUT);
    pin(GPIOB, SCK_PIN, ALTERNATE);
    pin(GPIOB, MOSI_PIN, ALTERNATE);
    SPI2_CR1 = SPI_CR1_SSM | SPI_CR1_SSI | SPI_CR1_MSTR | SPI_CR1_BR_4; /* 9 MHz, mode 0 */
    SPI2_CR1 |= SPI_CR1_SPE;
    radio_air = *air;
    sender_init(&telemetry);
    wait_us(0, NRF24_POWER_ON_US);
    nrf24_start_transmitter(&RADIO, &radio_air);
    start_timer(TIM2, 73, 65536, false); /* 73/72 us: the tick of a Crazyflie's own timer */
    start_timer(TIM3, MHZ, SENDER_PERIOD_US, true);
    interrupt_priority(IRQ_TIM3, 12);
    interrupt_enable(IRQ_TIM3);
}

uint16_t telemetry_ticks(void)
{
    return (uint16_t)TIM_CNT(TIM2);
}

void telemetry_publish(const sender_sample *sample)
{
    sender_sample newest = *sample;

    if (watching)
        newest.debug = blades.half_turn;
    sender_publish(&telemetry, &newest);
}

/* Both interrupts have one priority, so neither interrupts the other here. The counter wraps in
 * 66 ms and is looked at every 0.5 ms. */
static uint32_t now(void)
{
    long_ticks += (uint16_t)(telemetry_ticks() - (uint16_t)long_ticks);
    return long_ticks;
}

void telemetry_watch_blades(void)
{
    watching = true;
    pin(GPIOA, BLADE_PIN, INPUT);
    AFIO_EXTICR1 &= ~0xFu; /* EXTI 0 is PA0 */
    EXTI_FTSR |= 1u << BLADE_PIN;
    EXTI_IMR |= 1u << BLADE_PIN;
    interrupt_priority(IRQ_EXTI0, 12);
    interrupt_enable(IRQ_EXTI0);
}

void telemetry_send_interrupt(void)
{
    TIM_SR(TIM3) = 0;
    (void)now();
    (void)sender_tick(&telemetry, &RADIO, &radio_air);
}

void telemetry_blade_interrupt(void)
{
    EXTI_PR = 1u << BLADE_PIN;
    blade_timer_edge(&blades, now());
}
