/* SPDX-License-Identifier: Apache-2.0 */
#include "board.h"

#include "registers.h"

enum { MHZ = 168 };
enum { IRQ_PIN = 1, CE_PIN = 11, CS_PIN = 12, SCK_PIN = 13, MISO_PIN = 14, MOSI_PIN = 15 };
enum { DM_PIN = 11, DP_PIN = 12, GREEN_PIN = 12, RED_PIN = 14 };
enum { OUTPUT = 1, ALTERNATE = 2 };
enum { SPI2_FUNCTION = 5, OTG_FS_FUNCTION = 10 };

static void pin(uint32_t port, uint32_t number, uint32_t mode, uint32_t function)
{
    GPIO_AFR(port, number) |= function << (4 * (number % 8));
    GPIO_OSPEEDR(port) |= 3u << (2 * number);
    GPIO_MODER(port) |= mode << (2 * number);
}

static void write_pin(uint32_t port, uint32_t number, bool high)
{
    GPIO_BSRR(port) = 1u << (high ? number : number + 16);
}

static void clocks(void)
{
    RCC_CR |= RCC_CR_HSEON;
    while (!(RCC_CR & RCC_CR_HSERDY)) {
    }
    RCC_PLLCFGR = 7u << 24 | 1u << 22 | 336u << 6 | 8u; /* 8 MHz / 8 * 336 = 336; / 2, / 7 */
    RCC_CR |= RCC_CR_PLLON;
    FLASH_ACR = 1u << 10 | 1u << 9 | 1u << 8 | 5u; /* caches, prefetch, 5 wait states */
    while (!(RCC_CR & RCC_CR_PLLRDY)) {
    }
    RCC_CFGR = 4u << 13 | 5u << 10; /* APB2 84 MHz, APB1 42 MHz */
    RCC_CFGR |= 2u;
    while ((RCC_CFGR >> 2 & 3u) != 2u) {
    }
}

void board_init(void)
{
    clocks();
    cycles_start();
    RCC_AHB1ENR |= RCC_AHB1ENR_GPIOA | RCC_AHB1ENR_GPIOB | RCC_AHB1ENR_GPIOD;
    RCC_APB1ENR |= RCC_APB1ENR_SPI2;
    RCC_APB2ENR |= RCC_APB2ENR_SYSCFG;
    (void)RCC_APB2ENR; /* two cycles until they run */
    pin(GPIOD, GREEN_PIN, OUTPUT, 0);
    pin(GPIOD, RED_PIN, OUTPUT, 0);
    pin(GPIOA, DM_PIN, ALTERNATE, OTG_FS_FUNCTION);
    pin(GPIOA, DP_PIN, ALTERNATE, OTG_FS_FUNCTION);
    write_pin(GPIOB, CS_PIN, true);
    pin(GPIOB, CS_PIN, OUTPUT, 0);
    pin(GPIOB, CE_PIN, OUTPUT, 0);
    pin(GPIOB, SCK_PIN, ALTERNATE, SPI2_FUNCTION);
    pin(GPIOB, MISO_PIN, ALTERNATE, SPI2_FUNCTION);
    pin(GPIOB, MOSI_PIN, ALTERNATE, SPI2_FUNCTION);
    GPIO_PUPDR(GPIOB) |= 1u << (2 * IRQ_PIN); /* high while no radio is connected */
    SPI2_CR1 = SPI_CR1_SSM | SPI_CR1_SSI | SPI_CR1_MSTR | SPI_CR1_BR_8; /* 5.25 MHz, mode 0 */
    SPI2_CR1 |= SPI_CR1_SPE;
    SYSCFG_EXTICR1 = (SYSCFG_EXTICR1 & ~(0xFu << 4)) | 1u << 4; /* EXTI1 is PB1 */
    EXTI_FTSR |= 1u << IRQ_PIN;
    EXTI_IMR |= 1u << IRQ_PIN;
    interrupt_priority(IRQ_EXTI1, 2);
}

void board_wait_us(uint32_t us)
{
    cycles_wait(us * MHZ);
}

void board_lights(bool receiving, bool radio_missing)
{
    write_pin(GPIOD, GREEN_PIN, receiving);
    write_pin(GPIOD, RED_PIN, radio_missing);
}

void board_radio_interrupt(bool on)
{
    if (on)
        interrupt_enable(IRQ_EXTI1);
    else
        interrupt_disable(IRQ_EXTI1);
}

void board_radio_interrupt_seen(void)
{
    EXTI_PR = 1u << IRQ_PIN;
}

static void transfer(void *board, const uint8_t *out, uint8_t *in, uint8_t size)
{
    (void)board;
    write_pin(GPIOB, CS_PIN, false);
    for (uint8_t i = 0; i < size; i++) {
        while (!(SPI2_SR & SPI_SR_TXE)) {
        }
        SPI2_DR = out[i];
        while (!(SPI2_SR & SPI_SR_RXNE)) {
        }
        const uint8_t received = (uint8_t)SPI2_DR;
        if (in)
            in[i] = received;
    }
    write_pin(GPIOB, CS_PIN, true);
}

static void enable(void *board, bool high)
{
    (void)board;
    write_pin(GPIOB, CE_PIN, high);
}

static void wait_us(void *board, uint32_t us)
{
    (void)board;
    board_wait_us(us);
}

const nrf24_bus board_radio = { transfer, enable, wait_us, 0 };
