"""Runs: uninterrupted stretches of a recording on an even time grid.

Every estimate works on runs, so that a gap, a restart or another sample rate can never be read
as motion. A run may be cut further: by hand, or into what is fitted and what is held out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError
from groundstation.identification.supply_answer import at_the_rows_voltage
from groundstation.telemetry.arrays import Array
from groundstation.telemetry.samples import SampleBatch, on_even_grid, spans

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
    first, both at the row's voltage (``supply_answer``). start_s: device time of the first row;
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
    found = []
    for rows in uninterrupted(samples, label, least_s, _uneven):
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
    """Rows of the stretches of a recording that last at least ``least_s``.

    A restart ends a stretch, and so does what ``breaks`` says of (steps (n - 1,) s, the usual
    one).

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


def _uneven(steps: Array, usual_s: float) -> Mask:
    return np.abs(steps - usual_s) > STEP_TOLERANCE * usual_s
