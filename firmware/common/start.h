/* SPDX-License-Identifier: Apache-2.0 */
#ifndef START_H
#define START_H

void start_reset(void);
void start_stop(void);

#endif
