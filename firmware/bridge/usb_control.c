/* SPDX-License-Identifier: Apache-2.0 */
#include "usb_control.h"

#include <string.h>

enum { /* bmRequestType and bRequest in one number */
    GET_STATUS_DEVICE = 0x8000,
    GET_STATUS_INTERFACE = 0x8100,
    GET_STATUS_ENDPOINT = 0x8200,
    CLEAR_FEATURE_ENDPOINT = 0x0201,
    SET_ADDRESS = 0x0005,
    GET_DESCRIPTOR = 0x8006,
    GET_CONFIGURATION = 0x8008,
    SET_CONFIGURATION = 0x0009,
    GET_INTERFACE = 0x810A,
    SET_INTERFACE = 0x010B
};

enum { DEVICE = 1, CONFIGURATION = 2, STRING = 3 };

static const char *const STRINGS[] = { "", "groundstation", "Crazyflie telemetry bridge" };
enum { SERIAL_STRING = 3 };

_Static_assert(sizeof groundstation_usb_device_descriptor <= USB_CONTROL_BYTES
        && sizeof groundstation_usb_configuration_descriptor <= USB_CONTROL_BYTES
        && 2 + 2 * sizeof "Crazyflie telemetry bridge" <= USB_CONTROL_BYTES
        && 2 + 2 * USB_SERIAL_DIGITS <= USB_CONTROL_BYTES,
    "an answer must fit one packet of endpoint 0");

void usb_control_init(usb_control *self, const uint8_t id[USB_SERIAL_DIGITS / 2])
{
    static const char DIGITS[] = "0123456789ABCDEF";

    memset(self, 0, sizeof *self);
    for (int i = 0; i < USB_SERIAL_DIGITS / 2; i++) {
        self->serial[2 * i] = DIGITS[id[i] >> 4];
        self->serial[2 * i + 1] = DIGITS[id[i] & 0x0F];
    }
}

void usb_control_reset(usb_control *self)
{
    self->address = self->configuration = self->alternate = 0;
}

static int say(usb_control *self, const uint8_t *data, size_t size)
{
    memcpy(self->answer, data, size);
    return (int)size;
}

static int say_string(usb_control *self, uint8_t index)
{
    const char *text = index == SERIAL_STRING ? self->serial : STRINGS[index];
    const size_t letters = strlen(text);

    if (index == 0) { /* the one language: English, United States */
        static const uint8_t LANGUAGES[] = { 4, STRING, 0x09, 0x04 };
        return say(self, LANGUAGES, sizeof LANGUAGES);
    }
    self->answer[0] = (uint8_t)(2 + 2 * letters);
    self->answer[1] = STRING;
    for (size_t i = 0; i < letters; i++) {
        self->answer[2 + 2 * i] = (uint8_t)text[i];
        self->answer[3 + 2 * i] = 0;
    }
    return self->answer[0];
}

static int say_descriptor(usb_control *self, uint8_t kind, uint8_t index)
{
    switch (kind) {
    case DEVICE:
        return say(self, groundstation_usb_device_descriptor,
            sizeof groundstation_usb_device_descriptor);
    case CONFIGURATION:
        if (index != 0)
            return USB_CONTROL_STALL;
        return say(self, groundstation_usb_configuration_descriptor,
            sizeof groundstation_usb_configuration_descriptor);
    case STRING:
        return index <= SERIAL_STRING ? say_string(self, index) : USB_CONTROL_STALL;
    default:
        return USB_CONTROL_STALL;
    }
}

/* Powered by the bus, wakes nobody, and an isochronous endpoint never halts. */
static int say_status(usb_control *self)
{
    static const uint8_t STATUS[2] = { 0, 0 };
    return say(self, STATUS, sizeof STATUS);
}

/* The answer in full, however much of it was asked for. */
static int respond(usb_control *self, uint16_t request, uint16_t value, uint16_t index)
{
    switch (request) {
    case GET_DESCRIPTOR:
        return say_descriptor(self, (uint8_t)(value >> 8), (uint8_t)value);
    case GET_CONFIGURATION:
        return say(self, &self->configuration, 1);
    case GET_INTERFACE:
        return say(self, &self->alternate, 1);
    case GET_STATUS_DEVICE:
    case GET_STATUS_INTERFACE:
    case GET_STATUS_ENDPOINT:
        return say_status(self);
    case SET_ADDRESS:
        if (value > 127)
            return USB_CONTROL_STALL;
        self->address = (uint8_t)value;
        return 0;
    case SET_CONFIGURATION:
        if (value > 1)
            return USB_CONTROL_STALL;
        self->configuration = (uint8_t)value;
        self->alternate = 0;
        return 0;
    case SET_INTERFACE:
        if (index != GROUNDSTATION_USB_INTERFACE || value > GROUNDSTATION_USB_ALTERNATE)
            return USB_CONTROL_STALL;
        self->alternate = (uint8_t)value;
        return 0;
    case CLEAR_FEATURE_ENDPOINT:
        if (index != GROUNDSTATION_USB_ENDPOINT || value != 0)
            return USB_CONTROL_STALL;
        return 0;
    default:
        return USB_CONTROL_STALL;
    }
}

int usb_control_request(usb_control *self, const uint8_t setup[8])
{
    const uint16_t request = (uint16_t)(setup[0] << 8 | setup[1]);
    const uint16_t value = (uint16_t)(setup[2] | setup[3] << 8);
    const uint16_t index = (uint16_t)(setup[4] | setup[5] << 8);
    const uint16_t length = (uint16_t)(setup[6] | setup[7] << 8);
    const int whole = respond(self, request, value, index);

    return whole > length ? length : whole;
}
