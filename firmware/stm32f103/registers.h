/* The few registers of an STM32F103 that the craft's side uses: ST RM0008.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef STM32F103_REGISTERS_H
#define STM32F103_REGISTERS_H

#include "cortex_m.h"

/* Clocks, 7.3 */
#define RCC_CR REGISTER(0x40021000u)
#define RCC_CR_HSEON (1u << 16)
#define RCC_CR_HSERDY (1u << 17)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_CFGR REGISTER(0x40021004u)
#define RCC_CFGR_PLL_OF_HSE (1u << 16)
#define RCC_CFGR_HSE_HALVED (1u << 17)
#define RCC_CFGR_PLL_BY_9 (7u << 18)
#define RCC_CFGR_APB1_HALVED (4u << 8)
#define RCC_APB2ENR REGISTER(0x40021018u)
#define RCC_APB2ENR_AFIO (1u << 0)
#define RCC_APB2ENR_GPIOA (1u << 2)
#define RCC_APB2ENR_GPIOB (1u << 3)
#define RCC_APB1ENR REGISTER(0x4002101Cu)
#define RCC_APB1ENR_TIM2 (1u << 0)
#define RCC_APB1ENR_TIM3 (1u << 1)
#define RCC_APB1ENR_SPI2 (1u << 14)
#define FLASH_ACR REGISTER(0x40022000u)

/* Pins, 9.2 */
#define GPIOA 0x40010800u
#define GPIOB 0x40010C00u
#define GPIO_CR(port, pin) REGISTER((port) + ((pin) < 8 ? 0x00u : 0x04u))
#define GPIO_BSRR(port) REGISTER((port) + 0x10u)

/* Interrupts of pins, 9.4.3 and 10.3 */
#define AFIO_EXTICR1 REGISTER(0x40010008u)
#define EXTI_IMR REGISTER(0x40010400u)
#define EXTI_FTSR REGISTER(0x4001040Cu)
#define EXTI_PR REGISTER(0x40010414u)

/* SPI 2, 25.5 */
#define SPI2_CR1 REGISTER(0x40003800u)
#define SPI2_SR REGISTER(0x40003808u)
#define SPI2_DR REGISTER(0x4000380Cu)
#define SPI_CR1_MSTR (1u << 2)
#define SPI_CR1_BR_4 (1u << 3)
#define SPI_CR1_SPE (1u << 6)
#define SPI_CR1_SSI (1u << 8)
#define SPI_CR1_SSM (1u << 9)
#define SPI_SR_RXNE (1u << 0)
#define SPI_SR_TXE (1u << 1)

/* Timers 2 and 3, 15.4 */
#define TIM2 0x40000000u
#define TIM3 0x40000400u
#define TIM_CR1(timer) REGISTER((timer) + 0x00u)
#define TIM_CR1_CEN (1u << 0)
#define TIM_DIER(timer) REGISTER((timer) + 0x0Cu)
#define TIM_DIER_UIE (1u << 0)
#define TIM_SR(timer) REGISTER((timer) + 0x10u)
#define TIM_EGR(timer) REGISTER((timer) + 0x14u)
#define TIM_EGR_UG (1u << 0)
#define TIM_CNT(timer) REGISTER((timer) + 0x24u)
#define TIM_PSC(timer) REGISTER((timer) + 0x28u)
#define TIM_ARR(timer) REGISTER((timer) + 0x2Cu)

#define IRQ_EXTI0 6u
#define IRQ_TIM3 29u
#define IRQ_COUNT 43u

#endif
