/* The few registers of an STM32F407 that the bridge uses: ST RM0090.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef STM32F407_REGISTERS_H
#define STM32F407_REGISTERS_H

#include "cortex_m.h"

/* Clocks, 7.3 */
#define RCC_CR REGISTER(0x40023800u)
#define RCC_CR_HSEON (1u << 16)
#define RCC_CR_HSERDY (1u << 17)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_PLLCFGR REGISTER(0x40023804u)
#define RCC_CFGR REGISTER(0x40023808u)
#define RCC_AHB1ENR REGISTER(0x40023830u)
#define RCC_AHB1ENR_GPIOA (1u << 0)
#define RCC_AHB1ENR_GPIOB (1u << 1)
#define RCC_AHB1ENR_GPIOD (1u << 3)
#define RCC_AHB2ENR REGISTER(0x40023834u)
#define RCC_AHB2ENR_OTGFS (1u << 7)
#define RCC_APB1ENR REGISTER(0x40023840u)
#define RCC_APB1ENR_SPI2 (1u << 14)
#define RCC_APB2ENR REGISTER(0x40023844u)
#define RCC_APB2ENR_SYSCFG (1u << 14)
#define FLASH_ACR REGISTER(0x40023C00u)

/* Pins, 8.4 */
#define GPIOA 0x40020000u
#define GPIOB 0x40020400u
#define GPIOD 0x40020C00u
#define GPIO_MODER(port) REGISTER((port) + 0x00u)
#define GPIO_OSPEEDR(port) REGISTER((port) + 0x08u)
#define GPIO_PUPDR(port) REGISTER((port) + 0x0Cu)
#define GPIO_BSRR(port) REGISTER((port) + 0x18u)
#define GPIO_AFR(port, pin) REGISTER((port) + ((pin) < 8 ? 0x20u : 0x24u))

/* Interrupts of pins, 9.2.4 and 12.3 */
#define SYSCFG_EXTICR1 REGISTER(0x40013808u)
#define EXTI_IMR REGISTER(0x40013C00u)
#define EXTI_FTSR REGISTER(0x40013C0Cu)
#define EXTI_PR REGISTER(0x40013C14u)

/* SPI 2, 28.5 */
#define SPI2_CR1 REGISTER(0x40003800u)
#define SPI2_SR REGISTER(0x40003808u)
#define SPI2_DR REGISTER(0x4000380Cu)
#define SPI_CR1_MSTR (1u << 2)
#define SPI_CR1_BR_8 (2u << 3)
#define SPI_CR1_SPE (1u << 6)
#define SPI_CR1_SSI (1u << 8)
#define SPI_CR1_SSM (1u << 9)
#define SPI_SR_RXNE (1u << 0)
#define SPI_SR_TXE (1u << 1)

/* The chip's own number, 39.1: 12 bytes */
#define UNIQUE_ID ((const uint8_t *)(uintptr_t)0x1FFF7A10u)

/* USB on-the-go, full speed, 34.16 */
#define OTG 0x50000000u
#define OTG_GAHBCFG REGISTER(OTG + 0x008u)
#define OTG_GAHBCFG_GINT (1u << 0)
#define OTG_GUSBCFG REGISTER(OTG + 0x00Cu)
#define OTG_GUSBCFG_TRDT (0xFu << 10)
#define OTG_GUSBCFG_FDMOD (1u << 30)
#define OTG_GRSTCTL REGISTER(OTG + 0x010u)
#define OTG_GRSTCTL_CSRST (1u << 0)
#define OTG_GRSTCTL_RXFFLSH (1u << 4)
#define OTG_GRSTCTL_TXFFLSH (1u << 5)
#define OTG_GRSTCTL_AHBIDL (1u << 31)
#define OTG_GINTSTS REGISTER(OTG + 0x014u)
#define OTG_GINTMSK REGISTER(OTG + 0x018u)
#define OTG_GINT_RXFLVL (1u << 4)
#define OTG_GINT_USBRST (1u << 12)
#define OTG_GINT_ENUMDNE (1u << 13)
#define OTG_GINT_IEPINT (1u << 18)
#define OTG_GINT_OEPINT (1u << 19)
#define OTG_GINT_IISOIXFR (1u << 20)
#define OTG_GRXSTSP REGISTER(OTG + 0x020u)
#define OTG_GRXFSIZ REGISTER(OTG + 0x024u)
#define OTG_DIEPTXF0 REGISTER(OTG + 0x028u)
#define OTG_GCCFG REGISTER(OTG + 0x038u)
#define OTG_GCCFG_PWRDWN (1u << 16)
#define OTG_GCCFG_NOVBUSSENS (1u << 21)
#define OTG_DIEPTXF1 REGISTER(OTG + 0x104u)
#define OTG_DCFG REGISTER(OTG + 0x800u)
#define OTG_DCFG_FULL_SPEED (3u << 0)
#define OTG_DCFG_DAD (0x7Fu << 4)
#define OTG_DCTL REGISTER(OTG + 0x804u)
#define OTG_DCTL_SDIS (1u << 1)
#define OTG_DCTL_CGINAK (1u << 8)
#define OTG_DSTS REGISTER(OTG + 0x808u)
#define OTG_DIEPMSK REGISTER(OTG + 0x810u)
#define OTG_DOEPMSK REGISTER(OTG + 0x814u)
#define OTG_DAINT REGISTER(OTG + 0x818u)
#define OTG_DAINTMSK REGISTER(OTG + 0x81Cu)
#define OTG_DIEPCTL(n) REGISTER(OTG + 0x900u + 0x20u * (n))
#define OTG_DIEPINT(n) REGISTER(OTG + 0x908u + 0x20u * (n))
#define OTG_DIEPTSIZ(n) REGISTER(OTG + 0x910u + 0x20u * (n))
#define OTG_DOEPCTL0 REGISTER(OTG + 0xB00u)
#define OTG_DOEPINT0 REGISTER(OTG + 0xB08u)
#define OTG_DOEPTSIZ0 REGISTER(OTG + 0xB10u)
#define OTG_EPCTL_USBAEP (1u << 15)
#define OTG_EPCTL_EONUM (1u << 16)
#define OTG_EPCTL_ISOCHRONOUS (1u << 18)
#define OTG_EPCTL_STALL (1u << 21)
#define OTG_EPCTL_TXFIFO(n) ((uint32_t)(n) << 22)
#define OTG_EPCTL_CNAK (1u << 26)
#define OTG_EPCTL_SNAK (1u << 27)
#define OTG_EPCTL_SEVNFRM (1u << 28)
#define OTG_EPCTL_SODDFRM (1u << 29)
#define OTG_EPCTL_EPDIS (1u << 30)
#define OTG_EPCTL_EPENA (1u << 31)
#define OTG_EPINT_XFRC (1u << 0)
#define OTG_EPINT_EPDISD (1u << 1)
#define OTG_EPINT_STUP (1u << 3)
#define OTG_TSIZ_PACKETS(n) ((uint32_t)(n) << 19)
#define OTG_TSIZ_A_FRAME(n) ((uint32_t)(n) << 29)
#define OTG_DOEPTSIZ0_SETUPS(n) ((uint32_t)(n) << 29)
#define OTG_PCGCCTL REGISTER(OTG + 0xE00u)
#define OTG_FIFO(n) REGISTER(OTG + 0x1000u + 0x1000u * (n))

#define IRQ_EXTI1 7u
#define IRQ_OTG_FS 67u
#define IRQ_COUNT 82u

#endif
