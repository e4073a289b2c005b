"""Tables and series read by a column map: rows in order, of one craft, as channels."""

from __future__ import annotations

import difflib
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.rotations import attitude_of_quaternion
from groundstation.errors import BadInputError
from groundstation.recording.delimited import (
    Block,
    ColumnTable,
    TextTable,
    base_name,
    called,
    open_table,
)
from groundstation.recording.map_document import (
    NAMED,
    Channel,
    Plan,
    decided,
    known_map,
    map_for,
    map_of_table,
    plan_of,
)
from groundstation.recording.motor_columns import (
    DIFFERS,
    changes,
    differs,
    is_command,
    settle_duty,
    too_many,
)
from groundstation.recording.session import (
    EVERY_ROW,
    SYNTHESISED,
    Findings,
    Log,
    Recording,
    Rows,
    Series,
    Table,
    family_of,
    host_time_from_ticks,
)
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.packet import FULL_16_BIT
from groundstation.telemetry.samples import COLUMNS, SampleBatch, empty_samples
from groundstation.text import some

# Rows of a file in the order in which they were measured: counters that wrapped unwrapped, rows
# that were overtaken put where they belong, copies left out, restarts told from all of these.


WRAPS_S = tuple(2**bits * unit_s for bits in (32, 24) for unit_s in (1e-3, 1e-6))
"""Full turns of the counters that loggers use: ms and us in 32 and 24 bits."""
WRAPPED_WITHIN_S = 1.0
"""A counter that wrapped goes on within so much of its full turn."""
OVERTAKEN_ROWS, OVERTAKEN_S = 64, 1.0
"""A clock that goes back further, or for longer, has restarted."""
CLOCK = ("ticks", "host_time_ns", "segment", "copies")
"""Columns of a batch that say when a row came, and not what was measured."""
APART = 0.1
"""Usual steps by which a row that was overtaken keeps away from its neighbours: it fits where it is
missing, a restart runs over what is there."""


@dataclass(frozen=True, slots=True)
class RowOrder:
    """What became of a file's rows.

    rows: (m,) places of the rows that are kept, in order of time; None: all as they stand.
    ticks, segment, copies: (m,). wraps, overtaken, left_out: how many.
    """

    rows: NDArray[np.intp] | None
    ticks: NDArray[np.int64]
    segment: NDArray[np.int32]
    copies: NDArray[np.uint8]
    wraps: int = 0
    overtaken: int = 0
    left_out: int = 0

    @property
    def notes(self) -> dict[str, str]:
        """The counts that are not zero, for a recording's metadata."""
        counts = {"wraps": self.wraps, "out_of_order": self.overtaken, "copies": self.left_out}
        return {name: str(count) for name, count in counts.items() if count}

    def of(self, values: NDArray[Any]) -> NDArray[Any]:
        """A column (n, ...) of the file in this order."""
        return values if self.rows is None else values[self.rows]


def order_of(ticks: NDArray[np.int64], tick_s: float, columns: Sequence[NDArray[Any]]) -> RowOrder:
    """The order of rows whose clock reads ``ticks`` (n,) of ``tick_s``.

    columns: every other (n, ...) of the file that was read: rows of one time that are equal in all
    of them are copies.
    """
    ticks, wraps = _unwrapped(ticks, tick_s)
    steps = np.diff(ticks)
    if (steps > 0).all():
        plain = np.zeros(len(ticks), np.int32), np.ones(len(ticks), np.uint8)
        return RowOrder(None, ticks, *plain, wraps)
    stands_for = _copied(ticks, bool((steps < 0).any()), columns)
    copied = stands_for != np.arange(len(ticks))
    segment, overtaken = _segments(ticks, copied, tick_s)
    copied &= segment[stands_for] == segment  # alike before and behind a restart: by chance
    stands_for = np.where(copied, stands_for, np.arange(len(ticks)))
    rows = np.flatnonzero(~copied)
    copies = np.bincount(stands_for, minlength=len(ticks))[rows].clip(0, 255).astype(np.uint8)
    if overtaken:
        by_time = np.lexsort((ticks[rows], segment[rows]))
        rows, copies = rows[by_time], copies[by_time]
    left_out = int(copied.sum())
    kept = rows if overtaken or left_out else None
    return RowOrder(kept, ticks[rows], segment[rows], copies, wraps, overtaken, left_out)


def in_order(
    samples: SampleBatch, beside: Sequence[NDArray[Any]] = ()
) -> tuple[SampleBatch, RowOrder]:
    """A batch as a file has it in the order of its clock. beside: columns (n, ...) of the file that
    are no channels."""
    channels = [getattr(samples, name) for name in COLUMNS if name not in CLOCK]
    order = order_of(samples.ticks, samples.tick_s, [*channels, *beside])
    if order.rows is not None:
        samples = samples[order.rows]
    samples.ticks[:] = order.ticks
    samples.segment[:] = order.segment
    samples.copies[:] = order.copies
    return samples, order


def _unwrapped(ticks: NDArray[np.int64], tick_s: float) -> tuple[NDArray[np.int64], int]:
    """Ticks (n,) without the jumps of a counter that came round, and how often it did."""
    steps = np.diff(ticks)
    near = WRAPPED_WITHIN_S / tick_s
    jumps = np.flatnonzero(np.abs(steps) > min(WRAPS_S) / tick_s - near)
    added = np.zeros(len(ticks), np.int64)
    for turn in (round(turn_s / tick_s) for turn_s in WRAPS_S):
        low = np.minimum(ticks[jumps], ticks[jumps + 1])
        high = np.maximum(ticks[jumps], ticks[jumps + 1])
        here = jumps[(low >= 0) & (low <= near) & (high < turn) & (turn - high <= near)]
        added[here + 1] = -np.sign(steps[here]) * turn
    turned = 0
    for row in np.flatnonzero(added):
        if turned + added[row] < 0:  # nothing came round before: a pause of nearly a turn
            added[row] = 0
        turned += int(added[row])
    return (ticks + np.cumsum(added), int(np.sign(added).sum())) if len(jumps) else (ticks, 0)


def _copied(
    ticks: NDArray[np.int64], falls: bool, columns: Sequence[NDArray[Any]]
) -> NDArray[np.intp]:
    """The first of the rows that each row (n,) is a copy of; itself where it is none."""
    order = np.argsort(ticks, kind="stable") if falls else np.arange(len(ticks))
    again = np.flatnonzero(np.diff(ticks[order]) == 0) + 1
    for column in columns:
        one, other = column[order[again]], column[order[again - 1]]
        same = (one == other) | ((one != one) & (other != other))
        again = again[same if same.ndim == 1 else same.all(axis=1)]
    first = np.arange(len(ticks))
    first[again] = 0
    found = np.empty(len(ticks), np.intp)
    found[order] = order[np.maximum.accumulate(first)]
    return found


def _segments(
    ticks: NDArray[np.int64], copied: NDArray[np.bool_], tick_s: float
) -> tuple[NDArray[np.int32], int]:
    """Segment (n,) of each row, and how many rows were overtaken by later ones. copied: (n,)."""
    steps = np.diff(ticks)
    falls = np.flatnonzero(steps < 0) + 1
    segment = np.zeros(len(ticks), np.int32)
    if not len(falls):
        return segment, 0
    rising = steps[steps > 0]
    usual = float(np.median(rising)) if len(rising) else 0.0
    restarts: list[int] = []
    overtaken, start, placed = 0, 0, 0
    for row in map(int, falls):
        if row < placed:
            continue  # among rows that have their place already
        before = ticks[max(start, row - 4 * OVERTAKEN_ROWS) : row]
        top = int(before.max())
        until = min(row + OVERTAKEN_ROWS, len(ticks))
        ahead = np.flatnonzero(ticks[row:until] > top)
        end = row + int(ahead[0]) if len(ahead) else until
        late = ticks[row:end][~copied[row:end]]
        ends = len(ahead) > 0 or until == len(ticks)
        near = not len(late) or (top - int(late.min())) * tick_s <= OVERTAKEN_S
        if ends and near and _fits(late, before, usual):
            overtaken += len(late)
            placed = end
        else:
            restarts.append(row)
            start = row
    segment[restarts] = 1
    return np.cumsum(segment, dtype=np.int32), overtaken


def _fits(late: NDArray[np.int64], around: NDArray[np.int64], usual: float) -> bool:
    """Whether late rows fill holes between the others; what is earlier than all may be as many
    usual steps ahead of them as there are rows."""
    if not len(late):
        return True
    others = np.sort(around)
    if late.min() < others[0] - 2 * usual * len(late):
        return False
    place = np.searchsorted(others, late)
    below = late - others[np.maximum(place - 1, 0)]
    above = others[np.minimum(place, len(others) - 1)] - late
    far = np.iinfo(np.int64).max
    below, above = np.where(place > 0, below, far), np.where(place < len(others), above, far)
    fits = np.minimum(below, above) >= APART * usual
    return bool(fits.all() and (np.diff(np.sort(late)) > 0).all())


# Several crafts or sensors in one table: a column that says whose a row is, or a state that jumps
# back and forth from row to row.
#
# One craft's state is nearer to the row before than to an earlier one; a row of several crafts is
# nearer to the last row of its own. So the state is asked first, and names where it does not tell.


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
_VALUES_NAMED = 4
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


def require_one_craft(
    table: TextTable | ColumnTable, taken: Sequence[int], time: int | None
) -> None:
    """Raises BadInputError where a column says that the rows are several crafts' or sensors'.

    taken: places of columns that are channels, whose state is asked. time: place of the clock among
    them, None where there is none.
    """
    clock = None if time is None else _numbers(table.first_cells(time))
    states = [_numbers(table.first_cells(place)) for place in taken if place != time]
    for place, name in enumerate(table.names):
        if place in taken or not name:
            continue
        cells = [one.strip() for one in table.first_cells(place)]
        values = list(dict.fromkeys(cells))
        if not 2 <= len(values) <= MOST or len(cells) < 2:
            continue
        label = np.array([values.index(one) for one in cells])
        called, craft = WHOSE.fullmatch(name) is not None, CRAFT.search(name) is not None
        turned = np.flatnonzero(np.diff(label)) + 1
        told = [one or "(empty)" for one in values]
        text = all(np.isnan(_number(one)) for one in values)
        if len(turned) <= max(FEWEST, TURNS * len(cells)):
            owner = text and craft and "" not in values
            several = owner or ((called or text) and _begins_anew(clock, turned))
        else:
            nearer = _nearer(label, turned, states)
            most = MOST if called else FEW
            tells = len(values) <= most and sum(one > JUMPS for one in nearer) > 1
            smooth = any(one < SMOOTH for one in nearer)
            several = tells or ((craft or (called and not smooth)) and _whole(told))
        if several:
            raise BadInputError(
                f"{table.path}: rows of {len(told)} crafts or sensors: column {name!r} takes turns"
                f" between {some(told, _VALUES_NAMED)}; make a file of one: groundstation convert"
                f" FILE ONE.mcap --only {name}={told[0]}"
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


# Any other CSV through a column map: what ``map_document`` describes, applied to numbers.


COMMAND_TABLE = "command"
"""Table that keeps the firmware's ``motor.m1..m4`` where the duty comes from elsewhere."""
_LIMITS = {"ticks": (-4e18, 4e18), "debug": (0.0, 2.0**32 - 1)}


def read_mapped_csv(
    path: Path, source: str | Path | None = None, rows: Rows = EVERY_ROW
) -> Recording:
    """Read any CSV by the columns that a map names: one of ``NAMED``, a TOML file, or the one that
    ships and knows the header (None). Raises as ``read_mapped``."""
    skip = 0 if source is None else map_for(path, "csv", source)[0].skip
    return read_mapped(open_table(path, skip).chosen(rows), source, rows)


@np.errstate(invalid="ignore")  # damage may leave a NaN that numpy signals when it is converted
def read_mapped(
    table: TextTable | ColumnTable, source: str | Path | None, rows: Rows = EVERY_ROW
) -> Recording:
    """What a map (None: the one that ships and knows the columns) makes of a table.

    A time that goes backwards starts a new segment; an empty cell is NaN; a channel that is
    not mapped is NaN. There are no raw packets.

    Raises RecordingError where a file cannot be opened, BadInputError where the map is wrong
    (file and key), a column is missing, or a cell does not read (file, line, column).
    """
    column_map, where = map_of_table(table, source, rows)
    named = where in (table.path, *NAMED.values())
    plan = plan_of(column_map, where, called(table.names), table.said_by(named))
    places = [place_of(table, one, where) for one in plan.wanted]
    if rows.only is None:
        require_one_craft(table, places, None if plan.step_s else places[0])
    found = Findings(table.damage)
    return _recording(table.path, plan, table.blocks(places), table.names, found, named)


def _recording(
    path: Path,
    plan: Plan,
    blocks: Iterable[Block],
    names: Collection[str],
    found: Findings,
    named: bool = False,
) -> Recording:
    """What a plan makes of a file: samples with their clock, tables, and metadata.

    blocks: of the columns that the plan wants. names: every column of the file. found: what its
    reader found. named: as ``decided`` takes it.
    """
    batches: list[SampleBatch] = []
    kept = [np.empty((0, len(plan.kept)))]
    count, untimed, moved = 0, 0, np.zeros(len(plan.wanted), np.intp)
    for block in blocks:
        if not batches:
            plan, unclear = decided(plan, block.values, named)
            found.unclear.update(unclear)
        timed = np.arange(len(block.values))
        if not plan.step_s:
            timed = np.flatnonzero(np.isfinite(block.values[:, 0]))
        batches.append(_samples(plan, block, timed, count))
        values = block.values[timed]
        count += len(timed)
        untimed += len(block.values) - len(timed)
        moved += changes(values)
        kept.append(values[:, len(plan.channels) : len(plan.channels) + len(plan.kept)])
    if untimed and not count:
        raise BadInputError(f"{path}: no row has a time")
    samples = SampleBatch.concatenate(batches) if batches else empty_samples(0, plan.tick_s)
    motors = [k for k, one in enumerate(plan.channels) if one.field == "duty"]
    beside = [str(one.column) for one in plan.beside]
    crowd = too_many(moved[motors], moved[len(moved) - len(beside) :], beside)
    if crowd:
        samples.duty[:] = samples.rotor_rev_s[:] = np.nan
    samples, order = in_order(samples, [np.concatenate(kept)])
    samples.host_time_ns[:] = host_time_from_ticks(samples.ticks, plan.tick_s, samples.segment)
    tables = _tables(plan.kept, order.of(np.concatenate(kept)), samples.time_s)
    if not crowd:
        _settle(plan, samples, tables, found)
    if untimed:
        found.unclear["time"] = f"{untimed} rows without a time were left out"
    if crowd:
        found.unclear["duty"] = crowd
    if plan.map.vehicle is not None:
        vehicle = {"profile": plan.map.vehicle}
    elif plan.map.family is not None:
        vehicle = {"family": plan.map.family, "because": plan.map.title}
    else:
        vehicle = family_of(names, samples)
    return Recording(
        path=path,
        kind=plan.map.kind,
        samples=samples,
        tables=tables,
        metadata={
            "host_time": dict(SYNTHESISED),
            "column_map": plan.text,
            **found.metadata(order.notes),
            "vehicle": vehicle,
        },
        damage=list(found.damage),
    )


def _settle(plan: Plan, samples: SampleBatch, tables: Mapping[str, Table], found: Findings) -> None:
    """Make the motors' column the duty where it is the thrust command of a Crazyflie."""
    duty = [channel for channel in plan.channels if channel.field == "duty"]
    known = plan.map.vehicle is not None
    if duty and (plan.map.commands or all(is_command(one.column, known) for one in duty)):
        settle_duty(samples, found)
        return
    beside = tables[COMMAND_TABLE].columns if COMMAND_TABLE in tables else {}
    for channel in duty:
        command = beside.get(f"motor.m{(channel.index or 0) + 1}")
        if command is not None and channel.index is not None:
            asked = command.astype(np.float64) / FULL_16_BIT
            if differs(asked, samples.duty[:, channel.index].astype(np.float64)):
                found.notes.append(DIFFERS)
                return


def _tables(
    kept: Sequence[Channel], values: NDArray[np.float64], time_s: NDArray[np.float64]
) -> dict[str, Table]:
    """The columns (n, len(kept)) that are no channel of the samples, by the map's table names."""
    tables: dict[str, Table] = {}
    for channel, column in zip(kept, values.T, strict=True):
        table = tables.setdefault(channel.field, Table(time_s, {}))
        table.columns[str(channel.column)] = column
    return tables


def place_of(table: TextTable | ColumnTable, channel: Channel, map_path: Path) -> int:
    """Position in a row of the column that a channel names.

    Raises BadInputError where there is no such column, or more than one.
    """
    path, names = table.path, table.names
    if isinstance(channel.column, int):
        if channel.column > table.width:
            raise BadInputError(
                f"{map_path}: {channel.key}.column is {channel.column}, but {path} has "
                f"{table.width} columns"
            )
        return channel.column - 1
    given = names if channel.column in names else [base_name(one)[0] for one in names]
    found = given.count(channel.column)
    if found == 1:
        return given.index(channel.column)
    if found > 1:
        raise BadInputError(
            f"{path}: {found} columns are named {channel.column!r} "
            f"({channel.key} in {map_path}); give the column's number instead"
        )
    if not names:
        raise BadInputError(
            f"{path}: no header line, so {channel.key}.column in {map_path} must be a number"
        )
    near = difflib.get_close_matches(channel.column, names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise BadInputError(f"{path}: no column {channel.column!r} ({channel.key} in {map_path}){hint}")


@np.errstate(over="ignore", invalid="ignore")  # beyond what a channel holds is no value
def _samples(plan: Plan, block: Block, rows: NDArray[np.intp], first: int) -> SampleBatch:
    """Samples of some rows of a block, whose columns are those that a plan wants. first: number of
    the first row.

    Raises BadInputError for a value that cannot be.
    """
    values = block.values[rows]
    samples = empty_samples(len(values), plan.tick_s)
    if plan.step_s:
        numbers = np.arange(first, first + len(values))
        samples.ticks[:] = np.rint(numbers * (plan.step_s / plan.tick_s))
    quaternion = np.full((len(values), 4), np.nan)
    mapped = {channel.field for channel in plan.channels}
    for place, channel in enumerate(plan.channels):
        cells = values[:, place]
        if channel.field in _LIMITS:
            low, high = _LIMITS[channel.field]
            scaled = np.rint(cells * channel.scale)
            wrong = np.flatnonzero(~((scaled >= low) & (scaled <= high)))
            if len(wrong):
                why = f"{cells[wrong[0]]:g} cannot be {channel.key}"
                raise block.error(int(rows[wrong[0]]), place, why)
            getattr(samples, channel.field)[:] = scaled
            continue
        if channel.zero is not None:
            cells = np.maximum(cells - channel.zero, 0.0)
        if channel.field == "quaternion":
            quaternion[:, channel.index] = cells * channel.scale
        else:
            target = getattr(samples, channel.field)
            target = target if channel.index is None else target[:, channel.index]
            target[:] = cells * channel.scale
    if "quaternion" in mapped and not plan.by_angles:
        size = np.linalg.norm(quaternion, axis=1)
        known = np.isfinite(size) & (size > 0)
        unit = quaternion[known] / size[known, None]
        samples.attitude[known] = attitude_of_quaternion(unit)
    if plan.map.yaw_from == "north":
        yaw = samples.attitude[:, 2]
        yaw[:] = np.remainder(yaw + 1.5 * np.pi, math.tau) - np.pi
    return samples


# Logs of many series, each with a clock and columns of its own, through a column map.
#
# The map names the series that gives the rows; of any other, a row has what was last known at its
# time. A column is ``SERIES.FIELD``. A series goes by its own name, by the last part of a name with
# slashes, and by its type, as far as only one series has that name.


_Columns = Mapping[str, tuple[Series, NDArray[np.generic]]]
TOPIC = "topic"
"""By which the rows of one craft are chosen, ``--only topic=/cf1``."""


def read_mapped_series(
    path: Path, kind: Literal["ulog", "rosbag"], log: Log, source: str | Path | None
) -> Recording:
    """Read a log of many series by a map (None: the named one that knows it).

    Raises BadInputError where no map fits, and as ``read_mapped``.
    """
    by_name = _called(log.series)
    columns = _columns(by_name)
    listed = some([f"{one.name} ({one.type})" if one.type else one.name for one in log.series])
    if log.unread:
        listed += f"; types that do not parse: {some(log.unread)}"
    if source is None:
        source = known_map(kind, columns)
        if source is None:
            _refuse_several(path, log.series, lambda part: known_map(kind, _columns(part)))
            raise BadInputError(
                f"{path}: no known map fits its series ({listed}); say which channel each is with"
                " 'groundstation convert FILE --map', and read the file with --columns"
            )
    column_map, where = map_for(path, kind, source)
    rows = by_name.get(column_map.rows)
    if rows is None:
        _refuse_several(path, log.series, lambda part: column_map.rows in part)
    if rows is None or (rows.type in log.unread and not len(rows.time_ns)):
        raise BadInputError(
            f"{path}: no series {column_map.rows!r} (rows in {where}); it has {listed}"
        )
    plan = plan_of(column_map, where, columns)
    for channel in (*plan.channels, *plan.kept):
        if channel.column not in columns:
            raise BadInputError(
                f"{path}: no column {channel.column!r} ({channel.key} in {where}); a column is"
                f" SERIES.FIELD, the series are {listed}"
            )

    def refuse(row: int, place: int, why: str) -> BadInputError:
        return BadInputError(f"{path}: {plan.channels[place].column}, row {row + 1}: {why}")

    block = Block(_on_rows(plan, rows, columns), refuse)
    names = [name.rpartition(".")[2] for name in columns]
    return _recording(path, plan, [block], names, log.found)


def under(series: Sequence[Series], topic: str) -> list[Series]:
    """The series of one craft or sensor: of each type of which there are some under a topic, those
    alone, and all of any other type."""
    types = {one.type for one in series if _is_under(one.name, topic)}
    return [one for one in series if _is_under(one.name, topic) or one.type not in types]


def _is_under(name: str, topic: str) -> bool:
    return f"{name}/".startswith(f"{topic.rstrip('/')}/")


def _refuse_several(
    path: Path, series: Sequence[Series], fits: Callable[[dict[str, Series]], object]
) -> None:
    """Raises BadInputError where a map fits the series under some topics, which it names: those of
    several crafts or sensors, of which no name is one's alone."""
    parts = [one.name.split("/") for one in series]
    topics = {"/".join(one[:size]) for one in parts for size in range(1, len(one) + 1)} - {""}
    found: list[str] = []
    for topic in sorted(topics, key=lambda one: (one.count("/"), one)):
        if not any(_is_under(topic, one) for one in found) and fits(_called(under(series, topic))):
            found.append(topic)
    if found:
        raise BadInputError(
            f"{path}: topics of several crafts or sensors: {some(found)}; make a file of one:"
            f" groundstation convert BAG ONE.mcap --only {TOPIC}={found[0]}"
        )


@np.errstate(invalid="ignore")  # what is no number stays none
def _on_rows(plan: Plan, rows: Series, columns: _Columns) -> NDArray[np.float64]:
    """The planned columns at the times of ``rows``, shape (n, k): the last value known by then, NaN
    before the first."""
    wanted = plan.wanted
    values = np.full((len(rows.time_ns), len(wanted)), np.nan)
    places: dict[str, NDArray[np.intp]] = {}
    for index, channel in enumerate(wanted):
        series, given = columns[str(channel.column)]
        if series is rows:
            values[:, index] = given
            continue
        if series.name not in places:
            found = np.searchsorted(series.time_ns, rows.time_ns, side="right") - 1
            places[series.name] = found
        place = places[series.name]
        known = place >= 0
        values[known, index] = np.asarray(given, np.float64)[place[known]]
    return values


def _columns(by_name: Mapping[str, Series]) -> _Columns:
    """Every column by its name, ``SERIES.FIELD``."""
    return {
        f"{name}.{field}": (one, values)
        for name, one in by_name.items()
        for field, values in one.columns.items()
    }


def _called(series: Sequence[Series]) -> dict[str, Series]:
    """Each series by every name that it alone has."""
    names = [
        (name, one)
        for one in series
        for name in {one.name, one.name.rpartition("/")[2], one.type} - {""}
    ]
    times = Counter(name for name, _ in names)
    return {name: one for name, one in names if times[name] == 1 or name == one.name}
