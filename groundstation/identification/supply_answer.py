"""What the voltage does within a row that holds two settings of the motors.

A row has the voltage of one moment. Where it answers to a setting at once, through the resistance
of cell and leads, it was another under the row's first setting, and so was the craft's thrust: on
the stand-in of today's Brushless by 11 mV rms, alternating as the settings do.
"""

from __future__ import annotations

import numpy as np

from groundstation.telemetry.arrays import Array


class SupplyAnswer:
    """How far the voltage changes at once where the load does, learnt from row to row.

    The load: sum of the four squares of duty. A motor's supply current goes with its square as long
    as its speed stays, and it hardly changes from one setting to the next.
    """

    def __init__(self) -> None:
        self._before = np.full(2, np.nan)
        self._sums = np.zeros(2)

    def learn(self, duty: Array, step: Array, supply_v: Array) -> Array:
        """V of one unit of load, (n,), negative or 0: what rows until each of these have shown.

        Consecutive rows behind those of the last call, as of ``at_the_rows_voltage``; those that
        are NaN show nothing.
        """
        load = ((duty + 0.5 * step) ** 2).sum(axis=1)
        load[load == 0.0] = np.nan  # motors at rest show nothing of their supply
        rows = np.column_stack([self._before, [load, supply_v]])
        self._before = rows[:, -1]
        loads, volts = np.diff(rows)
        both = np.isfinite(loads) & np.isfinite(volts)
        terms = np.where(both, [loads**2, loads * volts], 0.0)
        sums = np.cumsum(np.column_stack([self._sums, terms]), axis=1)[:, 1:]
        self._sums = sums[:, -1]
        moved, answered = sums
        return np.minimum(
            np.divide(answered, moved, out=np.zeros_like(moved), where=moved > 0.0), 0.0
        )


def at_the_rows_voltage(
    duty: Array, step: Array, supply_v: Array, answer_v: Array | None = None
) -> tuple[Array, Array]:
    """Duty and step (n, 4) whose products with a row's voltage are what both settings got.

    duty: mean of a row's two settings; step: the second less the first; supply_v: (n,), read under
    the second; answer_v: of ``SupplyAnswer.learn``, near 0 where a reading is filtered, None: what
    all these rows show. Rows that do not tell two settings stay as they are.
    """
    if answer_v is None:
        answer_v = SupplyAnswer().learn(duty, step, supply_v)[-1:]
    known = np.isfinite(step).all(axis=1) & (supply_v > 0.0)
    first, second = duty - 0.5 * step, duty + 0.5 * step
    rise_v = answer_v * ((first**2).sum(axis=1) - (second**2).sum(axis=1))
    share = np.divide(rise_v, supply_v, out=np.zeros_like(supply_v), where=known)
    more = np.where(known[:, None], first * share[:, None], 0.0)
    return duty + 0.5 * more, step - more
