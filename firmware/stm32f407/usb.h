/* The bridge as a full-speed USB device on the STM32F407's OTG_FS controller.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef STM32F407_USB_H
#define STM32F407_USB_H

#include "queue.h"

/* Plugs in. Frames are taken from `packets` by the controller's interrupt. */
void usb_start(queue *packets);

/* To be called by the vector of OTG_FS. */
void usb_interrupt(void);

#endif
