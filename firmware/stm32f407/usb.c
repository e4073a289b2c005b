/* OTG_FS as a device, without DMA. One control endpoint and one isochronous one.
 *
 * An isochronous packet belongs to a frame: the controller is told the parity of the frame in
 * which it may answer. So each packet is prepared during the frame before its own, either when the
 * one before has gone (XFRC) or, where the host did not ask for it, near the end of the frame in
 * which it should have (IISOIXFR, after 80 % of a millisecond). RM0090 34.17.6.
 * SPDX-License-Identifier: Apache-2.0
 */
#include "usb.h"

#include <stddef.h>
#include <string.h>

#include "board.h"
#include "registers.h"
#include "usb_control.h"

enum { /* words of the controller's 320: the shared receive queue, then one for each IN endpoint */
    RX_WORDS = 128,
    TX0_WORDS = 32,
    TX1_WORDS = 64
};
enum { SETUP_RECEIVED = 6, OUT_RECEIVED = 2 }; /* GRXSTSP, packet status */
enum { STREAM = 1, ALL_FIFOS = 0x10 };

static usb_control control;
static queue *stream;
static uint32_t setup[2];

static void flush(uint32_t fifo)
{
    OTG_GRSTCTL = OTG_GRSTCTL_TXFFLSH | fifo << 6;
    while (OTG_GRSTCTL & OTG_GRSTCTL_TXFFLSH) {
    }
}

static void push(uint32_t fifo, const uint8_t *data, uint32_t size)
{
    for (uint32_t at = 0; at < size; at += 4) {
        uint32_t word = 0;
        memcpy(&word, data + at, size - at < 4 ? size - at : 4);
        OTG_FIFO(fifo) = word;
    }
}

/* Ready for the next setup packet, and for the empty packet that ends a request for data. */
static void expect_setup(void)
{
    OTG_DOEPTSIZ0 = OTG_DOEPTSIZ0_SETUPS(3) | OTG_TSIZ_PACKETS(1) | USB_CONTROL_BYTES;
    OTG_DOEPCTL0 |= OTG_EPCTL_EPENA | OTG_EPCTL_CNAK;
}

static void answer(const uint8_t *data, uint32_t size)
{
    OTG_DIEPTSIZ(0) = OTG_TSIZ_PACKETS(1) | size;
    OTG_DIEPCTL(0) |= OTG_EPCTL_EPENA | OTG_EPCTL_CNAK;
    push(0, data, size);
}

/* ---- the stream ---- */

static uint32_t frame_number(void)
{
    return OTG_DSTS >> 8;
}

/* What waits, at most two packets and often none, for the frame after this one. */
static void prepare_frame(void)
{
    static uint8_t content[GROUNDSTATION_USB_FRAME_BYTES];
    const uint32_t size = queue_take_frame(stream, content);
    const bool odd = ((frame_number() + 1) & 1) != 0;

    OTG_DIEPTSIZ(STREAM) = OTG_TSIZ_A_FRAME(1) | OTG_TSIZ_PACKETS(1) | size;
    OTG_DIEPCTL(STREAM) |=
        OTG_EPCTL_EPENA | OTG_EPCTL_CNAK | (odd ? OTG_EPCTL_SODDFRM : OTG_EPCTL_SEVNFRM);
    push(STREAM, content, size);
}

/* Take back what was prepared. */
static void withdraw_frame(void)
{
    if (OTG_DIEPCTL(STREAM) & OTG_EPCTL_EPENA) {
        OTG_DIEPINT(STREAM) = OTG_EPINT_EPDISD;
        OTG_DIEPCTL(STREAM) |= OTG_EPCTL_SNAK | OTG_EPCTL_EPDIS;
        for (int tries = 0; tries < 1000; tries++) {
            if (OTG_DIEPINT(STREAM) & OTG_EPINT_EPDISD)
                break;
        }
        OTG_DIEPINT(STREAM) = OTG_EPINT_EPDISD;
    }
    flush(STREAM);
}

static void start_or_stop(bool listening)
{
    withdraw_frame();
    if (!listening) {
        OTG_DIEPCTL(STREAM) = 0;
        return;
    }
    OTG_DIEPCTL(STREAM) = OTG_EPCTL_USBAEP | OTG_EPCTL_ISOCHRONOUS | OTG_EPCTL_TXFIFO(STREAM)
        | GROUNDSTATION_USB_FRAME_BYTES;
    queue_clear(stream); /* what came while nobody listened is old */
    prepare_frame();
}

static void frame_was_not_asked_for(void)
{
    const uint32_t endpoint = OTG_DIEPCTL(STREAM);
    const bool for_odd = (endpoint & OTG_EPCTL_EONUM) != 0;

    if ((endpoint & OTG_EPCTL_EPENA) && for_odd == ((frame_number() & 1) != 0)) {
        withdraw_frame();
        prepare_frame();
    }
}

/* ---- requests ---- */

static void request(void)
{
    uint8_t bytes[sizeof setup];
    const uint8_t alternate = control.alternate, configuration = control.configuration;
    bool selects;
    int size;

    memcpy(bytes, setup, sizeof bytes);
    size = usb_control_request(&control, bytes);
    if (size == USB_CONTROL_STALL) {
        OTG_DIEPCTL(0) |= OTG_EPCTL_STALL; /* both end with the next setup packet */
        OTG_DOEPCTL0 |= OTG_EPCTL_STALL;
        expect_setup();
        return;
    }
    /* The controller answers the rest of this request at the old address by itself. */
    OTG_DCFG = (OTG_DCFG & ~OTG_DCFG_DAD) | (uint32_t)control.address << 4;
    selects = (bytes[0] & 0x80) == 0 && (bytes[1] == 9 || bytes[1] == 11);
    if (selects && (control.alternate || alternate != control.alternate
            || configuration != control.configuration))
        start_or_stop(control.alternate == GROUNDSTATION_USB_ALTERNATE);
    answer(control.answer, (uint32_t)size);
    expect_setup();
}

static void bus_reset(void)
{
    usb_control_reset(&control);
    OTG_DCFG &= ~OTG_DCFG_DAD;
    OTG_DIEPCTL(STREAM) = 0;
    flush(ALL_FIFOS);
    OTG_GRXFSIZ = RX_WORDS;
    OTG_DIEPTXF0 = TX0_WORDS << 16 | RX_WORDS;
    OTG_DIEPTXF1 = TX1_WORDS << 16 | (RX_WORDS + TX0_WORDS);
    OTG_DAINTMSK = 1u << 16 | 1u << STREAM | 1u << 0;
    OTG_DOEPMSK = OTG_EPINT_STUP | OTG_EPINT_XFRC;
    OTG_DIEPMSK = OTG_EPINT_XFRC;
    expect_setup();
}

static void read_received(void)
{
    const uint32_t status = OTG_GRXSTSP;
    const uint32_t size = (status >> 4) & 0x7FF, kind = (status >> 17) & 0xF;

    if (kind == SETUP_RECEIVED) {
        setup[0] = OTG_FIFO(0);
        setup[1] = OTG_FIFO(0);
    } else if (kind == OUT_RECEIVED) { /* no request of ours sends any */
        for (uint32_t at = 0; at < size; at += 4)
            (void)OTG_FIFO(0);
    }
}

void usb_interrupt(void)
{
    while (OTG_GINTSTS & OTG_GINT_RXFLVL)
        read_received();

    const uint32_t pending = OTG_GINTSTS & OTG_GINTMSK;
    OTG_GINTSTS = pending & (OTG_GINT_USBRST | OTG_GINT_ENUMDNE | OTG_GINT_IISOIXFR);
    if (pending & OTG_GINT_USBRST)
        bus_reset();
    if (pending & OTG_GINT_ENUMDNE) { /* full speed: endpoint 0 has 64 bytes, code 0 */
        OTG_DIEPCTL(0) &= ~3u;
        OTG_DCTL |= OTG_DCTL_CGINAK;
    }
    if (pending & OTG_GINT_OEPINT) {
        const uint32_t out = OTG_DOEPINT0;
        OTG_DOEPINT0 = out;
        if (out & OTG_EPINT_STUP)
            request();
        else if (out & OTG_EPINT_XFRC)
            expect_setup();
    }
    if (pending & OTG_GINT_IEPINT) {
        OTG_DIEPINT(0) = OTG_DIEPINT(0);
        if (OTG_DIEPINT(STREAM) & OTG_EPINT_XFRC) {
            OTG_DIEPINT(STREAM) = OTG_EPINT_XFRC;
            if (control.alternate == GROUNDSTATION_USB_ALTERNATE)
                prepare_frame();
        }
    }
    if ((pending & OTG_GINT_IISOIXFR) && control.alternate == GROUNDSTATION_USB_ALTERNATE)
        frame_was_not_asked_for();
}

void usb_start(queue *packets)
{
    stream = packets;
    usb_control_init(&control, UNIQUE_ID);
    RCC_AHB2ENR |= RCC_AHB2ENR_OTGFS;
    while (!(OTG_GRSTCTL & OTG_GRSTCTL_AHBIDL)) {
    }
    OTG_GRSTCTL |= OTG_GRSTCTL_CSRST;
    while (OTG_GRSTCTL & OTG_GRSTCTL_CSRST) {
    }
    OTG_GCCFG = OTG_GCCFG_PWRDWN | OTG_GCCFG_NOVBUSSENS; /* PHY on; VBUS is not looked at */
    OTG_GUSBCFG = (OTG_GUSBCFG & ~OTG_GUSBCFG_TRDT) | OTG_GUSBCFG_FDMOD | 6u << 10;
    board_wait_us(25000); /* until the forced device mode counts */
    OTG_PCGCCTL = 0;
    OTG_DCFG |= OTG_DCFG_FULL_SPEED;
    OTG_DCTL |= OTG_DCTL_SDIS; /* unplugged, long enough that the host sees it after a restart */
    board_wait_us(10000);
    flush(ALL_FIFOS);
    OTG_GINTSTS = 0xFFFFFFFFu;
    OTG_GINTMSK = OTG_GINT_USBRST | OTG_GINT_ENUMDNE | OTG_GINT_RXFLVL | OTG_GINT_IEPINT
        | OTG_GINT_OEPINT | OTG_GINT_IISOIXFR;
    OTG_GAHBCFG |= OTG_GAHBCFG_GINT;
    interrupt_priority(IRQ_OTG_FS, 1);
    interrupt_enable(IRQ_OTG_FS);
    OTG_DCTL &= ~OTG_DCTL_SDIS;
}
