"""Runs: uninterrupted stretches of a recording on an even time grid, and what drives them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.simulation import armature_mv, simulate_motor, steady_rev_s
from groundstation.dynamics.vehicle import MIXERS, Configuration, MotorConstants, Motors
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import (
    HELD,
    SETTINGS_HZ,
    SampleBatch,
    filled,
    on_even_grid,
    renewals,
    slower_than_rows,
    spans,
)

# What the voltage does within a row that holds two settings of the motors.
#
# A row has the voltage of one moment. Where it answers to a setting at once, through the resistance
# of cell and leads, it was another under the row's first setting, and so was the craft's thrust: on
# the stand-in of today's Brushless by 11 mV rms, alternating as the settings do.


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


# Every estimate works on runs, so that a gap, a restart or another sample rate can never be read
# as motion. A run may be cut further: by hand, or into what is fitted and what is held out.


Mask = NDArray[np.bool_]

STEP_TOLERANCE = 0.5
"""A step that differs from the usual one by more than this share of it ends a run."""
FASTEST_HZ, SLOWEST_HZ = 2000.0, 50.0
OTHER_UNIT = 0.9
"""Share of rows with turning motors beyond full duty from which duty is no share of it."""


@dataclass(frozen=True, slots=True)
class Run:
    """One stretch, rows a constant ``period_s`` apart.

    duty: (n, 4), 0..1, acted from the row before to this one. supply_v: (n,) as reported.
    gyro: (n, 3) rad/s. accelerometer: (n, 3) m/s^2. attitude: (n, 3) rad.
    rotor_rev_s: (n, 4) measured speeds. debug_s: (n,) half a rotor revolution on the motor bench,
    in seconds. duty_step: (n, 4), where ``duty`` is the mean of two settings, the second less the
    first, both at the row's voltage (``SupplyAnswer``). start_s: device time of the first row;
    recording_start_s: of the recording's. A channel that is not there is NaN.
    """

    name: str
    start_s: float
    period_s: float
    duty: Array
    supply_v: Array
    gyro: Array
    accelerometer: Array
    attitude: Array
    rotor_rev_s: Array
    debug_s: Array
    duty_step: Array
    recording_start_s: float = 0.0

    def __len__(self) -> int:
        return len(self.duty)

    def __repr__(self) -> str:
        where = f"from {self.start_s:.2f} s on"
        return f"Run({self.name!r}, {where}: {self.seconds:.2f} s at {1 / self.period_s:.0f} Hz)"

    @property
    def seconds(self) -> float:
        return len(self) * self.period_s

    @property
    def time_s(self) -> Array:
        """Device time, (n,)."""
        return np.asarray(self.start_s + self.period_s * np.arange(len(self)), np.float64)

    @property
    def settings(self) -> Array:
        """What the motors were set to, (n, 4), or (2 n, 4) for half a period each where rows tell
        two settings."""
        return both_settings(self.duty, self.duty_step)

    def __getitem__(self, rows: slice) -> Run:
        """Some consecutive rows as a run of its own."""
        first, last, step = rows.indices(len(self))
        if step != 1 or last <= first:
            raise ValueError(f"run {self.name}: a part needs consecutive rows, not {rows}")
        parts = {name: getattr(self, name)[first:last] for name in CHANNELS}
        return replace(self, start_s=self.start_s + first * self.period_s, **parts)

    def parts(self, chosen: Mask, least_s: float) -> list[Run]:
        """The stretches of chosen rows (n,) that last ``least_s``."""
        return [self[a:b] for a, b in spans(chosen) if (b - a) * self.period_s >= least_s]


def both_settings(duty: Array, step: Array) -> Array:
    """Settings (2 n, 4) from their means (n, 4) and the second less the first (n, 4); the means
    alone where no step is known."""
    if not np.isfinite(step).any():
        return duty
    half = 0.5 * np.nan_to_num(step)
    return np.stack([duty - half, duty + half], axis=1).reshape(-1, duty.shape[1])


SCALARS = ("name", "start_s", "period_s", "recording_start_s")
CHANNELS = tuple(f.name for f in fields(Run) if f.name not in SCALARS)


def runs_of(samples: SampleBatch, name: str = "", least_s: float = 1.0) -> list[Run]:
    """The runs of a recording that last at least ``least_s`` seconds, in order of time.

    A row with an impossible duty counts as lost, one in which gyro or duty do not read as well, and
    rows that a host stamped stand where their craft took them. Raises BadInputError where no run is
    long enough, or where the rate is not one of inertial telemetry.
    """
    label = name or "recording"
    start = float(samples.time_s[0]) if len(samples) else 0.0
    samples = on_even_grid(with_readings(with_possible_duty(samples, label), ("gyro", "duty")))

    def uneven(steps: Array, usual_s: float) -> Mask:
        return np.abs(steps - usual_s) > STEP_TOLERANCE * usual_s

    found = []
    for rows in uninterrupted(samples, label, least_s, uneven):
        part = samples[rows]
        time = part.time_s
        period = float((time[-1] - time[0]) / (len(part) - 1))
        attitude = np.unwrap(part.attitude.astype(np.float64), axis=0)
        found.append(run_of(part, attitude, label, period, start))
    return found


def run_of(
    samples: SampleBatch,
    attitude: Array,
    name: str,
    period_s: float,
    recording_start_s: float,
    placed: Callable[[Array], Array] = lambda values: values,
) -> Run:
    """Rows (m,) of a batch as a run. attitude: (m, 3) rad, without jumps of a turn. placed: brings
    a channel (m, ...) onto the run's rows (n, ...)."""
    channels: dict[str, NDArray[np.floating]] = {
        "duty": samples.duty,
        "supply_v": samples.battery_v,
        "gyro": samples.gyro,
        "accelerometer": samples.accelerometer,
        "attitude": attitude,
        "rotor_rev_s": samples.rotor_rev_s,
        "debug_s": samples.debug * samples.tick_s,
        "duty_step": samples.duty_step,
    }
    parts = {key: placed(np.asarray(values, np.float64)) for key, values in channels.items()}
    inputs = parts["duty"], parts["duty_step"], parts["supply_v"]
    parts["duty"], parts["duty_step"] = at_the_rows_voltage(*inputs)
    start = float(samples.time_s[0])
    return Run(name, start, period_s, **parts, recording_start_s=recording_start_s)


IN_WORDS = {
    "duty": "what the motors are set to (PWM)",
    "supply_v": "the battery's voltage",
    "gyro": "the gyro",
    "attitude": "the attitude",
    "accelerometer": "the accelerometer",
    "rotor_rev_s": "the rotors' measured speed",
}
HELP = {
    "rotor_rev_s": "",
    "supply_v": "; 'groundstation convert IN OUT --supply-v V' gives one that was constant",
}
"""What helps where a channel is nowhere in a recording."""


def require_known(run: Run, names: Sequence[str], what_for: str) -> None:
    """Raises BadInputError for a channel of ``names`` that a run has not in every row: which, in
    how many, what needs it, and what helps."""
    for name in names:
        known = np.isfinite(getattr(run, name))
        lost = int(np.count_nonzero(~(known if known.ndim == 1 else known.all(axis=1))))
        if lost == len(run) and not known.any():
            help_it = HELP.get(name, "; record it as well")
            raise BadInputError(
                f"{run.name}: {IN_WORDS[name]} is nowhere in it; {what_for}{help_it}"
            )
        if lost:
            raise BadInputError(
                f"{run.name}: {IN_WORDS[name]} is missing in {lost} of {len(run)} samples;"
                f" {what_for}; 'groundstation inspect' counts them"
            )


class TooShortError(BadInputError):
    """A recording of which no uninterrupted stretch is long enough; others may be."""


def with_possible_duty(samples: SampleBatch, label: str) -> SampleBatch:
    """The rows whose duties can be.

    Raises BadInputError where hardly any with turning motors can: duty is in another unit.
    """
    beyond = samples.overdriven
    if not beyond.any():
        return samples
    if beyond.sum() > OTHER_UNIT * (samples.duty > 0.0).any(axis=1).sum():
        raise BadInputError(
            f"{label}: duty up to {np.nanmax(samples.duty):.4g}, where 1 is all a motor can be"
            " given; say in the column map how large full duty is"
        )
    return samples[~beyond]


def with_readings(
    samples: SampleBatch, names: Sequence[str], longest_s: float = 0.0
) -> SampleBatch:
    """The rows without those in which a channel does not read, for longer than so many seconds,
    that reads elsewhere: what was rejected there cannot be bridged."""
    lost = np.zeros(len(samples), np.bool_)
    usual_s = float(np.median(np.diff(samples.time_s))) if len(samples) > 1 else 0.0
    for name in names:
        known = np.isfinite(getattr(samples, name))
        missing = ~known[:, known.any(axis=0)].all(axis=1)
        for first, last in spans(missing):
            if (last - first) * usual_s > longest_s:
                lost[first:last] = True
    return samples[~lost] if lost.any() else samples


def uninterrupted(
    samples: SampleBatch, label: str, least_s: float, breaks: Callable[[Array, float], Mask]
) -> list[slice]:
    """Rows of the stretches of a recording that last at least ``least_s``. A restart ends one, and
    so does what ``breaks`` says of (steps (n - 1,) s, the usual one).

    Raises TooShortError where no stretch is long enough, BadInputError where the rate is not one of
    inertial telemetry.
    """
    if len(samples) < 3:
        raise TooShortError(f"{label}: {len(samples)} samples are too few; record a flight")
    time = samples.time_s
    steps = np.diff(time)
    usual = float(np.median(steps))
    if not 1 / FASTEST_HZ <= usual <= 1 / SLOWEST_HZ:
        raise BadInputError(
            f"{label}: a sample every {usual * 1e3:.3g} ms; {SLOWEST_HZ:.0f} to"
            f" {FASTEST_HZ:.0f} samples a second are needed"
        )
    ends = np.flatnonzero(breaks(steps, usual) | (np.diff(samples.segment) != 0)) + 1
    edges = np.concatenate([[0], ends, [len(samples)]])
    # By count as well: rounding must not shorten a stretch of exactly so long.
    seconds = np.maximum(time[edges[1:] - 1] - time[edges[:-1]] + usual, np.diff(edges) * usual)
    if seconds.max() < least_s:
        raise TooShortError(
            f"{label}: the longest uninterrupted stretch lasts {seconds.max():.2f} s, at least"
            f" {least_s:g} s are needed; record longer or improve the link"
        )
    long = np.flatnonzero(seconds >= least_s)
    return [slice(int(edges[k]), int(edges[k + 1])) for k in long]


# Recordings as the search wants them: whole flights on an even grid, lost rows as NaN.
#
# Identification cuts a recording at every gap. A radio that loses two rows in a hundred would leave
# it nothing; here short gaps become rows without values, and only long silences and restarts end
# a run.


LONGEST_GAP_S = 0.1
"""A longer silence ends a run: the motors' inputs are no longer known."""
ESSENTIAL = ("duty", "accelerometer")
"""Channels whose longer silences end a run, where they read elsewhere; the gyro's any does."""
LEAST_S = 5.0
SOURCES = {"duty": "what the motors are set to", "gyro": "the gyro"}
"""Fields that the fits need in every row, in words."""


def flights_of(samples: SampleBatch, name: str = "", least_s: float = LEAST_S) -> list[Run]:
    """The runs of a recording that last at least ``least_s``, rows lost in between being NaN.

    A row whose gyro does not read counts as lost, and so does one with an impossible duty. Rows
    that a host stamped stand where their craft took them; of rows that repeat what a slower source
    said, those are taken that renew it.

    Raises TooShortError where no run is long enough, BadInputError where the rate is not one of
    inertial telemetry.
    """
    label = name or "recording"
    possible = with_readings(with_possible_duty(samples, label), ESSENTIAL, LONGEST_GAP_S)
    whole = renewed(on_even_grid(possible), label)
    read: Mask = np.asarray(np.isfinite(whole.gyro).all(axis=1))
    if read.any() and not read.all():
        whole = whole[read]

    def silent(steps: Array, _usual_s: float) -> Mask:
        return (steps > LONGEST_GAP_S) | (steps < 0)

    parts = uninterrupted(whole, label, least_s, silent)
    return [_on_grid(whole[rows], label, float(samples.time_s[0])) for rows in parts]


def renewed(samples: SampleBatch, label: str) -> SampleBatch:
    """The rows in which the slower of gyro and motors is renewed, where rows come faster than it.

    What acted between two of them is then as unknown as in a recording of that rate. Rotor speeds
    that were measured drive a flight in place of the motors' settings.

    Raises BadInputError where it is renewed too seldom for inertial telemetry.
    """
    slowest, hold = _slowest(samples)
    if hold <= HELD:
        return samples
    usual_s = float(np.median(np.diff(samples.time_s)))
    hz = 1.0 / (hold * usual_s)
    if hz >= SETTINGS_HZ:
        return samples
    if hz < SLOWEST_HZ <= 1.0 / usual_s:
        raise BadInputError(
            f"{label}: {SOURCES[slowest]} is renewed {hz:.3g} times a second in"
            f" {1 / usual_s:.3g} rows a second; {SLOWEST_HZ:.0f} to {FASTEST_HZ:.0f} are needed:"
            " log it as often as the rows (PX4: SDLOG_PROFILE)"
        )
    new = renewals(getattr(samples, slowest))
    between = np.diff(new, append=len(samples))
    each = np.maximum(np.rint(between / hold), 1).astype(np.intp)  # also while it rests
    share = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
    rows = np.repeat(new, each) + np.rint(share * np.repeat(between / each, each)).astype(np.intp)
    return samples[rows]


def renewal_notes(samples: SampleBatch, name: str) -> list[str]:
    """What to say of a recording of which only some rows are taken, because they renew a slow
    channel."""
    slowest, hold = _slowest(samples)
    usual_s = float(np.median(np.diff(samples.time_s))) if len(samples) > 1 else 0.0
    if hold <= HELD or 1.0 / (hold * usual_s) >= SETTINGS_HZ:
        return []
    return [
        f"{name}: {SOURCES[slowest]} is renewed {1 / (hold * usual_s):.3g} times a second in"
        f" {1 / usual_s:.3g} rows a second: only the rows that renew it are used"
    ]


def _slowest(samples: SampleBatch) -> tuple[str, float]:
    """The slower of gyro and, where no speeds were measured, motors' settings, and how many rows
    its values stand."""
    speeds = np.isfinite(samples.rotor_rev_s).any(axis=0).all()
    names = ["gyro"] if speeds else list(SOURCES)
    found = {name: slower_than_rows(renewals(getattr(samples, name))) for name in names}
    return max(found.items(), key=lambda one: one[1])


def flights_of_each(
    recordings: Iterable[tuple[SampleBatch, str]],
) -> tuple[list[list[Run]], list[str]]:
    """The runs of recordings, each with its name: none where nothing lasts, which is told in words.

    Raises TooShortError where nothing lasts in any, and BadInputError as ``flights_of`` does.
    """
    found: list[list[Run]] = []
    short: list[TooShortError] = []
    for samples, name in recordings:
        try:
            found.append(flights_of(samples, name))
        except TooShortError as error:
            found.append([])
            short.append(error)
    if short and not any(found):
        raise short[0]
    return found, [f"left out: {error}" for error in short]


def _on_grid(samples: SampleBatch, label: str, recording_start_s: float) -> Run:
    """Rows on a grid whose period is the mean over steps without a gap."""
    time = samples.time_s
    steps = np.diff(time)
    whole = np.rint(steps / float(np.median(steps)))
    place = np.concatenate([[0], np.cumsum(np.maximum(whole, 1.0))]).astype(np.int64)
    period = float((time[-1] - time[0]) / place[-1])
    count = int(place[-1]) + 1

    def grid(values: Array) -> Array:
        out = np.full((count, *values.shape[1:]), np.nan)
        out[place] = np.where(np.isfinite(values), values, np.nan)
        return out

    attitude = samples.attitude.astype(np.float64)
    known = np.isfinite(attitude).all(axis=1)
    attitude[known] = np.unwrap(attitude[known], axis=0)
    return run_of(samples, attitude, label, period, recording_start_s, grid)


def bridged(samples: SampleBatch, name: str = "", least_s: float = LEAST_S) -> list[Run]:
    """The same with short gaps bridged on straight lines, for what a radio's losses would cut to
    pieces."""
    return [without_gaps(run) for run in flights_of(samples, name, least_s)]


def without_gaps(run: Run) -> Run:
    """The run with its missing rows filled in, for what needs every row.

    Measured speeds drive the rotors: silences longer than ``LONGEST_GAP_S`` are not filled.
    """
    parts: dict[str, Any] = {name: filled(getattr(run, name)) for name in CHANNELS}
    for rotor, silent in enumerate(~np.isfinite(run.rotor_rev_s.T)):
        for first, last in spans(silent):
            if (last - first) * run.period_s > LONGEST_GAP_S:
                parts["rotor_rev_s"][first:last, rotor] = np.nan
    return replace(run, **parts)


@dataclass(frozen=True, slots=True)
class Selection:
    """What to identify on.

    spans_s: (from, to) in seconds of device time since the recording's first row, any of which a
    row must lie in; none: the whole recording.
    """

    spans_s: tuple[tuple[float, float], ...] = ()

    def __str__(self) -> str:
        spans = ", ".join(f"{a:g} to {b:g} s" for a, b in self.spans_s)
        return f"in {spans}" if spans else "anything"


EVERYTHING = Selection()


def parse_selection(segments: tuple[str, ...] = ()) -> Selection:
    """A selection as typed: ``12.5:40`` (seconds). Raises BadInputError."""
    spans_s = []
    for text in segments:
        try:
            low, high = (float(part) for part in text.split(":"))
        except ValueError:
            low, high = math.nan, math.nan
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise BadInputError(f"--segment {text}: give two rising numbers, for instance 12.5:40")
        spans_s.append((low, high))
    return Selection(tuple(spans_s))


def selected(run: Run, selection: Selection) -> Mask:
    """Rows (n,) of a run that a selection chooses."""
    if not selection.spans_s:
        return np.ones(len(run), np.bool_)
    time = run.time_s - run.recording_start_s
    return np.any([(time >= a) & (time < b) for a, b in selection.spans_s], axis=0)


# From motor voltages to the mixer's u' (thesis 7.3.4): what turns the body.


SMOOTH_S = 0.018
SATURATED = 0.995
"""Duty above which a motor gives all it has."""


@dataclass(frozen=True, slots=True)
class RotorSquares:
    """Squared rotor speeds behind a run.

    square: (n, 4) (rev/s)^2, mean over the period that ends with the row. end: (n, 4) at the row.
    """

    square: Array
    end: Array

    def mixed(self, configuration: Configuration) -> Array:
        """u' (n, 3) of eq. 7.19, mean over the period that ends with the row."""
        return self.square @ MIXERS[configuration].T


def mostly_saturated(run: Run) -> bool:
    """Whether a motor gives all it has in more than half of the rows."""
    return bool((run.duty.max(axis=1) >= SATURATED).mean() > 0.5)


def by_saturation(runs: Sequence[Run]) -> tuple[list[Run], list[Run]]:
    """(runs that PWM steers, those in most rows of which a motor is saturated)."""
    found: tuple[list[Run], list[Run]] = [], []
    for run in runs:
        found[mostly_saturated(run)].append(run)
    return found


def rotor_squares(run: Run, motor: MotorConstants | Motors) -> RotorSquares:
    """Squared rotor speeds by simulating the motors, settled at the first row's voltage.

    Raises BadInputError where duty or battery voltage are missing, or motors mostly saturated.
    """
    settings = run.settings
    each = len(settings) // len(run)
    voltage = armature_mv(settings, np.repeat(run.supply_v, each))
    require_known(run, ("duty", "supply_v"), "the motors need it")
    if mostly_saturated(run):
        raise BadInputError(
            f"{run.name}: a motor is saturated in more than half of the rows; the torque does not"
            " follow the control there: fly with less thrust or a full battery"
        )
    driving = np.maximum(voltage, 0.0)
    start = steady_rev_s(motor, driving[0])
    speed, square = simulate_motor(motor, driving[each:], run.period_s / each, start)
    mean = square.reshape(-1, each, square.shape[1]).mean(axis=1)
    return RotorSquares(np.vstack([start**2, mean]), speed[::each] ** 2)


def measured_squares(run: Run) -> RotorSquares:
    """Squared rotor speeds as recorded.

    Raises BadInputError where some rows have none.
    """
    require_known(run, ("rotor_rev_s",), "fit without --measured-rotors")
    # Speeds count by their steps from row to row (the rotors' acceleration turns the craft as
    # well), which are mostly noise as they come: parabolas over ``SMOOTH_S`` have less of it.
    from scipy.signal import savgol_filter

    width = 2 * round(0.5 * SMOOTH_S / run.period_s) + 1
    if width <= 3:
        return squares_between(run.rotor_rev_s)
    return squares_between(np.asarray(savgol_filter(run.rotor_rev_s, width, 2, axis=0), np.float64))


def squares_between(speed: Array) -> RotorSquares:
    """Squares of speeds (n, 4), rev/s, which are straight between rows."""
    before = np.vstack([speed[:1], speed[:-1]])
    return RotorSquares((speed**2 + before**2 + before * speed) / 3, speed**2)
