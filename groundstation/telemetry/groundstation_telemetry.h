/* Telemetry of the Crazyflie ground station: packet, serial frame and USB descriptors.
 * 'groundstation export header' writes it; its tests compare it with the codec in Python.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef GROUNDSTATION_TELEMETRY_H
#define GROUNDSTATION_TELEMETRY_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the packet is little-endian: swap its fields on this processor"
#endif

/* A compile-time check that C99 has too: an array of size -1 is an error. */
#define GROUNDSTATION_REQUIRE(condition, name) \
    typedef char groundstation_require_##name[(condition) ? 1 : -1]

/* ---- packet: one every 2 ms, sent as it lies in memory ---- */

#define GROUNDSTATION_PACKET_BYTES 32

typedef struct {
    uint16_t timestamp;         /* ticks of 73/72 us, wraps every 66.4 ms */
    uint16_t battery;           /* mV */
    uint8_t motors[6];          /* 4 x 12 bits, M1 lowest, 1/4096 duty, steps of 8 */
    int16_t gyro[3];            /* x y z, 1/16.384 deg/s, raw register */
    int16_t accelerometer[3];   /* x y z, 1/4096 g */
    int16_t angles[3];          /* roll, pitch (nose up positive), yaw, 0.01 deg */
    uint32_t debug;             /* free; half a rotor revolution in ticks on the motor bench */
} groundstation_packet;

GROUNDSTATION_REQUIRE(offsetof(groundstation_packet, timestamp) == 0, timestamp_at_0);
GROUNDSTATION_REQUIRE(offsetof(groundstation_packet, battery) == 2, battery_at_2);
GROUNDSTATION_REQUIRE(offsetof(groundstation_packet, motors) == 4, motors_at_4);
GROUNDSTATION_REQUIRE(offsetof(groundstation_packet, gyro) == 10, gyro_at_10);
GROUNDSTATION_REQUIRE(offsetof(groundstation_packet, accelerometer) == 16, accelerometer_at_16);
GROUNDSTATION_REQUIRE(offsetof(groundstation_packet, angles) == 22, angles_at_22);
GROUNDSTATION_REQUIRE(offsetof(groundstation_packet, debug) == 28, debug_at_28);
GROUNDSTATION_REQUIRE(sizeof(groundstation_packet) == 32, whole_packet);

/* Pack four motor values of 12 bits, M1 first. */
static inline void groundstation_pack_motors(uint8_t out[6], const uint16_t motors[4])
{
    int pair;
    for (pair = 0; pair < 2; pair++) {
        const uint16_t first = motors[2 * pair], second = motors[2 * pair + 1];
        out[3 * pair] = (uint8_t)(first & 0xff);
        out[3 * pair + 1] = (uint8_t)(((first >> 8) & 0x0f) | ((second & 0x0f) << 4));
        out[3 * pair + 2] = (uint8_t)((second >> 4) & 0xff);
    }
}

/* ---- serial: 2000000 baud 8N1, COBS(packet, CRC low byte first), then a zero ---- */

#define GROUNDSTATION_BAUD 2000000UL
#define GROUNDSTATION_FRAME_BYTES 36

/* CRC-16/CCITT-FALSE: "123456789" gives 0x29b1. */
static inline uint16_t groundstation_crc16(const uint8_t *data, size_t size)
{
    uint16_t crc = 0xffff;
    size_t i;
    int bit;
    for (i = 0; i < size; i++) {
        crc = (uint16_t)(crc ^ ((uint16_t)data[i] << 8));
        for (bit = 0; bit < 8; bit++)
            crc = (uint16_t)((crc & 0x8000) ? (crc << 1) ^ 0x1021 : crc << 1);
    }
    return crc;
}

/* The frame of one packet. */
static inline void groundstation_frame(
    uint8_t out[GROUNDSTATION_FRAME_BYTES], const groundstation_packet *packet)
{
    uint8_t *body = out + 1;
    const uint16_t crc =
        groundstation_crc16((const uint8_t *)packet, GROUNDSTATION_PACKET_BYTES);
    int i, next_zero = 35;
    memcpy(body, packet, GROUNDSTATION_PACKET_BYTES);
    body[GROUNDSTATION_PACKET_BYTES] = (uint8_t)(crc & 0xff);
    body[GROUNDSTATION_PACKET_BYTES + 1] = (uint8_t)(crc >> 8);
    out[35] = 0;
    for (i = 35 - 1; i >= 0; i--) { /* each zero becomes the way to the next */
        if (i == 0 || out[i] == 0) {
            out[i] = (uint8_t)(next_zero - i);
            next_zero = i;
        }
    }
}

/* ---- USB: 0, 1 or 2 whole packets in each isochronous frame of 1 ms ---- */

#define GROUNDSTATION_USB_VENDOR_ID 0x0483
#define GROUNDSTATION_USB_PRODUCT_ID 0x5741
#define GROUNDSTATION_USB_INTERFACE 0
#define GROUNDSTATION_USB_ALTERNATE 1
#define GROUNDSTATION_USB_ENDPOINT 0x81
#define GROUNDSTATION_USB_FRAME_BYTES 64

/* Full speed. Strings: 1 maker, 2 product, 3 serial number. */
static const uint8_t groundstation_usb_device_descriptor[] = {
    0x12, 0x01, 0x00, 0x02, 0x00, 0x00, 0x00, 0x40,
    0x83, 0x04, 0x41, 0x57, 0x00, 0x01, 0x01, 0x02,
    0x03, 0x01,
};

/* Alternate setting 0 has no endpoint, setting 1 the isochronous one. */
static const uint8_t groundstation_usb_configuration_descriptor[] = {
    0x09, 0x02, 0x22, 0x00, 0x01, 0x01, 0x00, 0x80,
    0x32, 0x09, 0x04, 0x00, 0x00, 0x00, 0xff, 0x00,
    0x00, 0x00, 0x09, 0x04, 0x00, 0x01, 0x01, 0xff,
    0x00, 0x00, 0x00, 0x07, 0x05, 0x81, 0x01, 0x40,
    0x00, 0x01,
};

#endif
