"""Several crafts or sensors in one table: a column that says whose a row is, or a state that jumps
back and forth from row to row.

One craft's state is nearer to the row before than to an earlier one; a row of several crafts is
nearer to the last row of its own. So the state is asked first, and names where it does not tell.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import SampleBatch

LOOKED_AT = 4000
"""First rows of a table in which columns are looked at."""
WHOSE = re.compile(
    r"(?:.*[._ ])?(?:uri|id|i|inst|instance|craft|crazyflie|drone|vehicle|robot|agent|uav|quad|cf"
    r"|address|src_?system|sys_?id|comp_?id|multi_?id|device|serial|rigid_?body|frame_?id|topic)"
    r"(?:[._ ]?(?:id|no|nr|number|name))?",
    re.IGNORECASE,
)
"""Names of columns that say whose a row is, also where the state does not tell."""
CRAFT = re.compile(r"(?:^|[._ ])(?:uri|craft|crazyflie|drone|robot|agent|uav|cf)", re.IGNORECASE)
"""Names of columns of which two texts are two crafts, one after the other as well."""
MOST, TURNS, FEWEST = 64, 0.1, 10
"""Values that such a column takes at most, and the share and the number of rows at which it changes
at least."""
SHOWN = 4
LAGS = 24
"""Crafts in turn that a state is tried for."""
JUMPS, SMOOTH, FEW = 3.0, 0.8, 8
"""A row is so many times nearer to the last row of its own than to the row before, where they are
several crafts', by two channels; less, where one craft moves smoothly. Columns of other names may
take so many values: one of more is a number of the craft's own."""
WINDOW, LARGE = 128, 0.15
"""Rows in which steps are sorted into small and large, and the least share of either."""
DIGITS = 4.0
"""Steps of a channel's last digit that a jump is above."""
ALIKE = 0.7
"""Correlation of an angle's steps with the gyro from which the craft really turned so."""


def whose_column(
    names: Sequence[str],
    texts: Callable[[int], Sequence[str]],
    taken: Sequence[int],
    time: int | None = None,
) -> tuple[str, list[str]] | None:
    """The column by which the rows of a table are several crafts' or sensors', and its values; None
    where there is none.

    texts: cells of the column at a place, of the first rows and some of the last. taken: places of
    columns that are channels, whose state is asked. time: place of the clock among them.
    """
    clock = None if time is None else _numbers(texts(time))
    states = [_numbers(texts(place)) for place in taken if place != time]
    for place, name in enumerate(names):
        if place in taken or not name:
            continue
        cells = [one.strip() for one in texts(place)]
        values = list(dict.fromkeys(cells))
        if not 2 <= len(values) <= MOST or len(cells) < 2:
            continue
        label = np.array([values.index(one) for one in cells])
        called = WHOSE.fullmatch(name) is not None
        turned = np.flatnonzero(np.diff(label)) + 1
        told = [one or "(empty)" for one in values]
        text = all(np.isnan(_number(one)) for one in values)
        if len(turned) <= max(FEWEST, TURNS * len(cells)):
            owner = text and CRAFT.search(name) is not None and "" not in values
            if owner or ((called or text) and _begins_anew(clock, turned)):
                return name, told
            continue
        nearer = _nearer(label, turned, states)
        tells = len(values) <= (MOST if called else FEW) and sum(one > JUMPS for one in nearer) > 1
        smooth = any(one < SMOOTH for one in nearer)
        craft = CRAFT.search(name) is not None
        if tells or ((craft or (called and not smooth)) and _whole(told)):
            return name, told
    return None


def refusal(name: str, values: Sequence[str]) -> str:
    """What to say of rows of several."""
    more = f" and {len(values) - SHOWN} more" if len(values) > SHOWN else ""
    return (
        f"rows of {len(values)} crafts or sensors: column {name!r} takes turns between"
        f" {', '.join(values[:SHOWN])}{more}; make a file of one: groundstation convert"
        f" FILE ONE.mcap --only {name}={values[0]}"
    )


def jumps(samples: SampleBatch) -> str:
    """What to say of rows whose state jumps back and forth, or empty: the attitude, where there is
    one, or else the battery. One craft's motors and gyro do alternate from row to row."""
    rows = samples[: 4 * LOOKED_AT]
    if len(rows) < 2 * WINDOW:
        return ""
    attitude = rows.attitude.astype(np.float64)
    if np.isfinite(attitude).all(axis=1).mean() > 0.5:
        step_s = np.diff(rows.time_s)
        for k, name in enumerate(("roll", "pitch", "yaw")):
            rate = rows.gyro[:, k].astype(np.float64)
            turned = 0.5 * (rate[1:] + rate[:-1]) * step_s
            if _jumps(attitude[:, k]) and not _agrees(np.diff(attitude[:, k]), turned):
                return _JUMPING.format(name)
        return ""
    battery, load = rows.battery_v.astype(np.float64), rows.duty.astype(np.float64).mean(axis=1)
    if _jumps(battery) and not _agrees(-np.diff(battery), np.diff(load)):
        return _JUMPING.format("the battery")
    return ""


_JUMPING = (
    "{} jumps back and forth from row to row: rows of several crafts or sensors? Make a file for"
    " each"
)


def _nearer(
    label: NDArray[np.intp], turned: NDArray[np.intp], states: Sequence[Array]
) -> list[float]:
    """How many times nearer rows behind a turn are to the last row of their own than to the row
    before, by each channel that moves."""
    last: dict[int, int] = {}
    own = np.full(len(label), -1)
    for row, one in enumerate(label.tolist()):
        own[row] = last.get(one, -1)
        last[one] = row
    rows = turned[own[turned] >= 0]
    found = []
    for state in states:
        if len(rows) < FEWEST or len(state) != len(label):
            continue
        before, back = np.abs(state[rows] - state[rows - 1]), np.abs(state[rows] - state[own[rows]])
        known = np.isfinite(before) & np.isfinite(back)
        if known.sum() >= FEWEST and before[known].any():
            own_m = max(float(back[known].mean()), 1e-12)
            found.append(float(before[known].mean()) / own_m)
    return found


def _begins_anew(clock: Array | None, turned: NDArray[np.intp]) -> bool:
    """Whether the clock goes back wherever the column turns."""
    if clock is None or not len(turned) or len(clock) <= turned[-1]:
        return False
    return bool((clock[turned] < clock[turned - 1]).all())


def _jumps(column: Array) -> bool:
    """Whether a channel jumps back and forth: it is back after some rows, or its steps are of two
    sizes, and the large ones cancel."""
    step = np.diff(column[np.isfinite(column)])
    if len(step) < 2 * WINDOW - 1 or _returns(column):
        return len(step) >= 2 * WINDOW - 1
    windows = [step[k : k + WINDOW] for k in range(0, len(step) - WINDOW + 1, WINDOW)]
    return 2 * sum(map(_two_sizes, windows)) > len(windows)


def _returns(column: Array) -> bool:
    """Whether a channel is back where it was after the same number of rows, again and again."""
    known = column[np.isfinite(column)]
    steps = np.abs(np.diff(known))
    if len(known) < 2 * WINDOW or not steps.any():
        return False
    near, digit = float(np.median(steps)), float(np.diff(np.unique(known)).min())
    return near > DIGITS * digit and any(
        float(np.median(np.abs(known[lag:] - known[:-lag]))) * (JUMPS + 1.0) < near
        for lag in range(2, LAGS + 1)
    )


def _two_sizes(step: Array) -> bool:
    """Whether steps are small or large with nothing between, and the large ones cancel."""
    sizes = np.sort(np.abs(step[step != 0.0]))
    least = max(3, round(LARGE * len(step)))
    if len(sizes) < 3 * least:
        return False
    ratio = sizes[least:-least] / sizes[least - 1 : -least - 1]
    place = int(np.argmax(ratio))
    if ratio[place] < JUMPS:
        return False
    large = step[np.abs(step) >= sizes[least + place]]
    back = np.mean(np.sign(large[1:]) != np.sign(large[:-1]))
    return bool(back > 0.6 and abs(large.sum()) < 0.2 * np.abs(large).sum())


def _agrees(step: Array, turned: Array) -> bool:
    known = np.isfinite(step) & np.isfinite(turned)
    size = float(np.sqrt((step[known] ** 2).sum() * (turned[known] ** 2).sum()))
    return size > 0.0 and float((step[known] * turned[known]).sum()) > ALIKE * size


def _whole(values: Sequence[str]) -> bool:
    """Whether numbers among the values are whole, as those of crafts are."""
    numbers = [_number(one) for one in values]
    return all(np.isnan(one) or one == round(one) for one in numbers)


def _numbers(cells: Sequence[str]) -> Array:
    return np.array([_number(one) for one in cells])


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan
