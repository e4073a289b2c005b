/* Answers to requests on endpoint 0 (USB 2.0 chapter 9), without any hardware.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef USB_CONTROL_H
#define USB_CONTROL_H

#include <stdint.h>

#include "groundstation_telemetry.h"

#define USB_CONTROL_BYTES 64 /* of endpoint 0: every answer fits one packet */
#define USB_CONTROL_STALL (-1)
#define USB_SERIAL_DIGITS 24

typedef struct {
    uint8_t address;       /* to be used after the status stage; many controllers want it before */
    uint8_t configuration; /* 0: not configured */
    uint8_t alternate;     /* GROUNDSTATION_USB_ALTERNATE: the host listens */
    char serial[USB_SERIAL_DIGITS + 1];
    uint8_t answer[USB_CONTROL_BYTES];
} usb_control;

/* id: the 12 bytes that every STM32 has of its own; they become the serial number. */
void usb_control_init(usb_control *self, const uint8_t id[USB_SERIAL_DIGITS / 2]);

/* The bus was reset: default state, address 0. */
void usb_control_reset(usb_control *self);

/* Answer one setup packet: bytes of `answer` to send (0 for a request without data), or
 * USB_CONTROL_STALL. */
int usb_control_request(usb_control *self, const uint8_t setup[8]);

#endif
