/* From reset to main on a Cortex-M: memory as C expects it, nothing else.
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdint.h>

#include "start.h"

/* From the linker script. */
extern uint32_t data_begin, data_end, data_in_flash, bss_begin, bss_end;

int main(void);

void start_reset(void)
{
    const uint32_t *from = &data_in_flash;

    for (uint32_t *to = &data_begin; to < &data_end;)
        *to++ = *from++;
    for (uint32_t *to = &bss_begin; to < &bss_end;)
        *to++ = 0;
    main();
    start_stop();
}

/* An interrupt nobody asked for, a fault: stay, so that a debugger finds where. */
void start_stop(void)
{
    for (;;)
        __asm volatile("");
}
