"""Whether a recording can be held against a model: its channels, its rotors, its craft."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from groundstation.comparison.gap import GYRO, AheadErrors, Motion, motion_of
from groundstation.dynamics.craft import craft_of_model
from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.registry import EFFECTS, ROTORS_TURN_BY
from groundstation.dynamics.rotations import euler_rates
from groundstation.dynamics.simulation import duties_for
from groundstation.dynamics.vehicle import MIXERS
from groundstation.errors import BadInputError
from groundstation.identification.runs import Run, measured_squares, without_gaps
from groundstation.telemetry.arrays import AXES, Array
from groundstation.telemetry.packet import STANDARD_GRAVITY
from groundstation.telemetry.samples import spans

# Recordings that a model cannot be held against, refused in words.


LEAST_FLIGHT_S = 3.0
NEEDED = {"gyro": "the gyro", "duty": "the motors' PWM", "supply_v": "the battery voltage"}
"""Channels that nothing works without."""


def missing_channel(run: Run) -> str | None:
    """In words, the first of ``NEEDED`` that is missing throughout."""
    for name, what in NEEDED.items():
        if not np.isfinite(getattr(run, name)).any(axis=0).all():
            return what
    return None


def require_channels(runs: Sequence[Run]) -> None:
    """Raises BadInputError where a channel that nothing works without is missing throughout."""
    for run in runs:
        what = missing_channel(run)
        if what is not None:
            raise BadInputError(
                f"{run.name}: {what} is not in the recording; where a model and a flight"
                " disagree cannot be told without it: record it"
            )


def require_flight(errors: Sequence[AheadErrors]) -> None:
    """Raises BadInputError where hardly anything flies."""
    flown = sum(float(one.motion.flown.sum()) * one.run.period_s for one in errors)
    if flown < LEAST_FLIGHT_S:
        names = ", ".join(sorted({one.run.name for one in errors}))
        raise BadInputError(
            f"{names}: {flown:.1f} s in the air, at least {LEAST_FLIGHT_S:.0f} s are needed;"
            " record a flight"
        )


def require_predictions(errors: Sequence[AheadErrors]) -> None:
    """Raises BadInputError where a model predicts no number of a rate in any row."""
    known = sum(np.isfinite(one.step[:, GYRO]).sum(axis=0) for one in errors)
    if not np.all(known):
        names = ", ".join(sorted({one.run.name for one in errors}))
        raise BadInputError(
            f"{names}: the model predicts no number there: something in it grows without end;"
            " look at its motor constants and at effects of your own first"
        )


# Flights whose rows do not tell how fast their rotors turned, though speeds were recorded.
#
# Where a controller swings the settings from row to row, motors coast in between and a row holds
# one of several settings. Predictions, which are driven by PWM and battery voltage, then have
# torques that no rotor made.


BAND_S = (0.05, 1.0)
"""Means over these are subtracted: what turns a craft, not vibration nor the battery's part."""
UNRELATED = 2.0
"""Variance of modelled less measured, over that of the measured: what signals of the same size have
that are not related to each other."""
LEAST_REV_S = 1.0
"""Of what is off at least: sensors that count revolutions are a third of that off by themselves,
and sums of four twice as much."""
LEAST_DUTY = 0.12
"""A rotor that coasts still turns, which is told by a duty above a tenth: less ends a flight."""
FOLLOWS_ALONE = 0.3
"""Correlation of each rotor with its own settings, less what all four do: below it columns may be
interchanged, or a sensor is dead."""


def driven_by_speeds(run: Run, model: Model, motion: Motion) -> tuple[Run, str]:
    """A run with the settings by which the model's motors turn as measured while it flies, and why;
    the run itself and no words where PWM and battery voltage tell as much, or where an effect of
    supply or motors stands between settings and speeds. motion: the run's under the model."""
    stages = {EFFECTS[one.name].stage for one in model.effects if one.name in EFFECTS}
    if not stages.isdisjoint(ROTORS_TURN_BY) or not motion.flown.any():
        return run, ""
    whole = without_gaps(run)
    if not np.isfinite(whole.rotor_rev_s).all():
        return run, ""
    measured = np.sqrt(measured_squares(whole).end)
    modelled, turned = (
        _moving(one, run.period_s)[motion.flown] for one in (np.sqrt(motion.squares.end), measured)
    )
    driven, shown = (one - one.mean(axis=1, keepdims=True) for one in (modelled, turned))
    if not all(np.std(one, axis=0).all() for one in (driven, shown)):
        return run, ""  # what never changes follows nothing
    own = np.diag(np.corrcoef(driven, shown, rowvar=False)[:4, 4:])
    mixer = MIXERS[model_vehicle(model).configuration].T
    errors, sizes = (np.std(one @ mixer, axis=0) for one in (modelled - turned, turned))
    worst = int(np.argmax(errors - UNRELATED**0.5 * sizes))
    least = max(LEAST_REV_S, UNRELATED**0.5 * sizes[worst])
    if errors[worst] < least or not own.min() >= FOLLOWS_ALONE:
        return run, ""
    told = np.isfinite(run.duty) & motion.flown[:, None]
    duty = np.where(told, _settings(whole, measured, model), run.duty)
    axis = ("roll", "pitch", "yaw")[worst]
    return replace(run, duty=duty, duty_step=np.full_like(run.duty_step, np.nan)), (
        f"{run.name}: PWM and battery voltage do not tell how its rotors turned: what drives"
        f" {axis} is off by {errors[worst]:.2g} rev/s where it changes by {sizes[worst]:.2g}"
        " (settings that swing from row to row let motors coast, or are not all in the rows);"
        " predictions are driven by the measured speeds"
    )


def _moving(speed: Array, period_s: float) -> Array:
    from scipy.ndimage import uniform_filter1d

    short, long = (
        uniform_filter1d(speed, max(round(seconds / period_s), 1), axis=0) for seconds in BAND_S
    )
    return short - long


def _settings(run: Run, speed: Array, model: Model) -> Array:
    """Duty (n, 4) behind speeds (n, 4) in rev/s."""
    craft, supply_mv = craft_of_model(model), 1000.0 * run.supply_v
    before = np.vstack([speed[:1], speed[:-1]])
    mean, slope = 0.5 * (speed + before), (speed - before) / run.period_s
    rows = zip(mean, slope, supply_mv, strict=True)
    duty = np.array([duties_for(craft, *row) for row in rows])
    return np.maximum(duty, LEAST_DUTY)


# Whether the channels of a recording fit together, and to the craft of a model.
#
# Checked before anything is predicted, on what no effect in the list can fake: the sign and scale
# of the gyro beside the attitude, which rotors turn the craft about which axis, how strongly, and
# the thrust that carries it. Between 4 and 18 Hz torque and angular acceleration go together:
# below, slow moments of the air are answered by the controller, above there is vibration.


BAND_HZ = (4.0, 18.0)
LATEST_S = 0.03
"""Response window: exceeds dead time, filters and sensor lag of any craft that flies."""
LAGS = 8
"""Delays that are tried within ``LATEST_S``."""
LEAST_SPAN_S, LEAST_TOLD_S = 2.0, 3.0
EXPLAINED, CLEARLY = 0.4, 0.25
"""Share of the angular acceleration about roll and pitch that rotors must explain to say anything,
and by how much more than as recorded (real flights: 0.75 to 0.97 as they are, below 0.55 with
rotors exchanged or turned by 45 degrees)."""
STRENGTH = 5.0
"""Another craft's answer to torque: no effect in the list changes it so much."""
THRUST = (0.5, 2.0)
"""Another craft's thrust per mass; payloads and batteries stay within."""
WINDOW_S, TURNED, TREMBLED = 0.1, np.radians(1.0), np.radians(0.1)
"""Angle and integrated gyro are compared over this, where they turn by as much (RMS); their signs
already where they tremble so much, as real crafts do at hover (0.1 to 0.5 deg, correlation 0.93 and
more on three of them)."""
SCALE, TOGETHER = (0.5, 2.0), 0.8
"""Angle over integrated gyro, and the correlation from which it means something."""
CARRIED, CARRIED_WINDOW_S = 0.1, 0.25
"""Of a change of thrust the specific force shows all in the air (the model's of a craft ten times
as heavy a tenth; a third to all of it on real flights at hover), nothing on a bench; means over so
long, for a craft shakes."""
CARRIED_WINDOWS, CARRIED_ERRORS = 8, 5.0
"""Fewest windows to tell, and standard errors by which it must be less."""
FORCE = (5.0, 20.0)
"""Median magnitude of the specific force in flight, m/s^2: it carries the craft, 9.8."""
FOLLOWS, OTHERS_FOLLOW = 0.5, 0.8
"""Correlation of a measured rotor speed with the one that PWM and voltage make: below, its sensor
is broken, if the best of the others is above."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Which rotors turn the craft: a configuration, two motors exchanged or none, and an axis
    (0, 1) about which the gyro has the other sign, or none."""

    configuration: str
    swapped: tuple[int, int] | None = None
    inverted: int | None = None

    @property
    def mixer(self) -> Array:
        """(2, 4): torque about roll and pitch per squared speed, in the recording's columns."""
        rows = MIXERS[self.configuration][:2].copy()
        if self.swapped is not None:
            rows[:, list(self.swapped)] = rows[:, list(self.swapped[::-1])]
        if self.inverted is not None:
            rows[self.inverted] *= -1.0
        return rows


@dataclass(frozen=True, slots=True)
class Answer:
    """Share of the angular acceleration (2,) that one gain for each axis explains, negative where
    the gain is, and the gains (2,) in (rad/s^2) per (rev/s)^2."""

    explained: Array
    gains: Array

    @property
    def score(self) -> float:
        return float(self.explained.mean())


def require_consistent(
    runs: Sequence[Run], model: Model, motions: Sequence[Motion] | None = None
) -> None:
    """Raises BadInputError, with what was measured, what was expected and the likeliest causes.

    motions: of the model on these runs, where they are known.
    """
    whole = [without_gaps(run) for run in runs]
    moved = [motion_of(run, model) for run in whole] if motions is None else motions
    names = ", ".join(dict.fromkeys(run.name for run in runs))
    flown = [(run, motion) for run, motion in zip(whole, moved, strict=True) if motion.flown.any()]
    if sum(float(motion.flown.sum()) * run.period_s for run, motion in flown) < LEAST_TOLD_S:
        return  # too little to tell; whoever needs a flight says so
    told = _answers(flown)
    said = (
        _force(flown)
        or _held(flown)
        or _rotors(told, model)
        or _turning(flown)
        or _strength(told, model)
        or _thrust(flown)
    )
    if said:
        raise BadInputError(f"{names}: {said}")


def broken_rotor_sensors(run: Run, model: Model) -> list[int]:
    """Rotors (0..3) whose measured speed does not follow what drives them."""
    if not np.isfinite(run.rotor_rev_s).any():
        return []
    whole = without_gaps(run)
    motion = motion_of(whole, model)
    if not motion.flown.any():
        return []
    driven = np.sqrt(motion.squares.end[motion.flown])
    measured = np.nan_to_num(whole.rotor_rev_s[motion.flown])
    follows = np.array([_correlation(driven[:, k], measured[:, k]) for k in range(4)])
    if follows.max() < OTHERS_FOLLOW:
        return []
    return [int(k) for k in np.flatnonzero(follows < FOLLOWS)]


def _force(flown: Sequence[tuple[Run, Motion]]) -> str:
    sizes = [np.linalg.norm(run.accelerometer[motion.flown], axis=1) for run, motion in flown]
    size = float(np.median(np.concatenate(sizes)))
    if not np.isfinite(size) or FORCE[0] < size < FORCE[1]:
        return ""
    in_g = 0.5 < size < 2.0
    first = "it is in g where m/s^2 are meant" if in_g else "its unit or scale is another"
    return (
        f"the accelerometer shows {size:.3g} m/s^2 in flight, {STANDARD_GRAVITY:.1f} carry a craft;"
        f" likeliest {first} (give a column map), or the sensor is stuck"
    )


def _held(flown: Sequence[tuple[Run, Motion]]) -> str:
    """Whether the craft is carried by its thrust, or by a bench or a hand."""
    pairs = []
    for run, motion in flown:
        length = max(1, round(CARRIED_WINDOW_S / run.period_s))
        both = np.column_stack([motion.thrust, run.accelerometer[:, 2]])[motion.flown]
        windows = both[: len(both) // length * length].reshape(-1, length, 2).mean(axis=1)
        # From one to the next: at hover what changes over a flight is the battery's part in the
        # model's thrust, which is never quite right, and no change of thrust at all.
        pairs.append(np.diff(windows, axis=0))
    thrust, felt = np.concatenate(pairs).T
    energy = float(thrust @ thrust)
    if len(thrust) < CARRIED_WINDOWS or not np.isfinite(felt).all() or energy == 0.0:
        return ""
    share = float(thrust @ felt) / energy
    error = float(np.sqrt(np.mean((felt - share * thrust) ** 2) / energy))
    if share + CARRIED_ERRORS * error > CARRIED:
        return ""
    return (
        f"of every change of thrust the accelerometer shows {max(share, 0.0):.0%}, where it shows"
        " all on a craft that thrust carries; likeliest the craft was held, on the motor bench for"
        " one ('groundstation fit motor' takes such recordings; record a flight), or the"
        " accelerometer is stuck"
    )


def _turning(flown: Sequence[tuple[Run, Motion]]) -> str:
    """Whether the attitude turns as the gyro says."""
    pairs: list[tuple[Array, Array]] = []
    for run, motion in flown:
        if not np.isfinite(run.attitude).all():
            continue
        rows = max(1, round(WINDOW_S / run.period_s))
        turned = np.cumsum(euler_rates(run.attitude, run.gyro), axis=0) * run.period_s
        both = motion.flown[rows:] & motion.flown[:-rows]
        said = (turned[rows:] - turned[:-rows])[both]
        done = (run.attitude[rows:] - run.attitude[:-rows])[both]
        pairs.append((said - said.mean(axis=0), done - done.mean(axis=0)))
    if not pairs:
        return ""
    said, done = (np.concatenate(part) for part in zip(*pairs, strict=True))
    scales: dict[int, float] = {}
    for axis in range(3):
        sizes = [float(np.sqrt((part[:, axis] ** 2).mean())) for part in (said, done)]
        together = _correlation(said[:, axis], done[:, axis])
        least = TURNED if together > 0.0 else TREMBLED
        if max(sizes) > least and abs(together) > TOGETHER:
            # Both are noisy: a regression of either on the other would be too flat.
            scales[axis] = float(np.sign(together)) * sizes[1] / sizes[0]
    wrong = {axis: s for axis, s in scales.items() if not SCALE[0] < s < SCALE[1]}
    if not wrong:
        return ""
    listed = ", ".join(f"{AXES[axis]} {scale:.3g}" for axis, scale in wrong.items())
    measured = f"the attitude turns {listed} times as fast as the gyro says, where 1 is expected"
    size = float(np.median(np.abs(list(wrong.values()))))
    if min(wrong.values()) < 0.0:
        which = " and ".join(AXES[axis] for axis, scale in wrong.items() if scale < 0.0)
        return (
            f"{measured}; likeliest {which} has the other sign in the recording (the firmware"
            " sends pitch with the nose up positive, here it is nose down), or that axis of the"
            " gyro has: correct the sign in the column map"
        )
    if abs(np.log(size * 180.0 / np.pi)) < 0.3:
        cause = "the gyro is in deg/s where rad/s are meant, or the attitude's unit is another"
    elif abs(np.log(size * np.pi / 180.0)) < 0.3:
        cause = "the gyro is in rad/s where deg/s are meant, or the attitude's unit is another"
    else:
        cause = "the gyro's scale or range is another than the recording says, or its rate is"
    return f"{measured}; likeliest {cause}: correct the unit in the column map"


def _answers(flown: Sequence[tuple[Run, Motion]]) -> dict[Hypothesis, Answer]:
    """How well roll and pitch answer to the rotors under each hypothesis, at its best delay."""
    power = [one for run, motion in flown for one in _powers(run, motion)]
    if not power:
        return {}
    summed = [np.sum(part, axis=0) for part in zip(*power, strict=True)]
    swaps: list[tuple[int, int] | None] = [None, *combinations(range(4), 2)]
    every = [Hypothesis(*one) for one in product(MIXERS, swaps)]
    every += [Hypothesis(one, inverted=axis) for one in MIXERS for axis in (0, 1)]
    return {
        one: max(
            (_answer(one, *part) for part in zip(*summed, strict=True)),
            key=lambda answer: answer.score,
        )
        for one in every
    }


def _rotors(told: dict[Hypothesis, Answer], model: Model) -> str:
    """Whether the rotors turn the craft as the model's configuration says."""
    if not told:
        return ""
    given = Hypothesis(model_vehicle(model).configuration)
    best = max(told, key=lambda one: told[one].score)
    if told[best].score <= max(EXPLAINED, told[given].score + CLEARLY):
        return ""
    share, before = (100.0 * max(told[one].score, 0.0) for one in (best, given))
    if best.inverted is not None:
        axis = AXES[best.inverted]
        return (
            f"{axis} turns against its torque: of roll and pitch acceleration the rotors explain"
            f" {share:.0f} % with the other sign, {before:.0f} % as recorded; likeliest that axis"
            " of the gyro has the other sign in the recording (correct the column map), or the"
            " board is mounted upside down"
        )
    if best.swapped is None:
        return (
            f"of roll and pitch acceleration the rotors explain {share:.0f} % in configuration"
            f" {best.configuration!r}, {before:.0f} % in the model's {given.configuration!r};"
            " likeliest the craft is flown in the former (give a model or --vehicle of it), or the"
            " sensor board is mounted turned by 45 deg"
        )
    motors = " and ".join(f"M{rotor + 1}" for rotor in best.swapped)
    also = "" if best.configuration == given.configuration else f" in {best.configuration!r}"
    return (
        f"of roll and pitch acceleration the rotors explain {share:.0f} % with {motors} exchanged"
        f"{also}, {before:.0f} % as recorded; likeliest these two columns are exchanged in the"
        " recording (correct the column map), or the axis of the gyro between them has the other"
        " sign"
    )


def _strength(told: dict[Hypothesis, Answer], model: Model) -> str:
    """Whether roll and pitch answer to torque as strongly as this craft's can."""
    assert model.body is not None
    if not told:
        return ""
    vehicle = model_vehicle(model)
    answer, usual = told[Hypothesis(vehicle.configuration)], vehicle.body_constants[:2]
    for axis, (said, profile) in enumerate(zip((model.body.c0, model.body.c1), usual, strict=True)):
        if answer.explained[axis] < EXPLAINED:
            continue
        gain = float(answer.gains[axis])
        # A gain that is far too small may come from flights with a lasting torque, which a smaller
        # gain explains: then the profile's decides.
        if said / STRENGTH < gain < STRENGTH * max(said, profile):
            continue
        return (
            f"{AXES[axis]} answers to torque by {gain:.3g} (rad/s^2)/(rev/s)^2, the model's"
            f" c{axis} is {said:.3g} and its vehicle's {profile:.3g}; likeliest the model is"
            " another craft's (fit one to this one), or the gyro's unit or the motors' constants"
            " are wrong"
        )
    return ""


def _thrust(flown: Sequence[tuple[Run, Motion]]) -> str:
    ratios = [
        np.median(run.accelerometer[motion.flown, 2]) / np.median(motion.thrust[motion.flown])
        for run, motion in flown
    ]
    worst = max(ratios, key=lambda ratio: abs(np.log(max(ratio, 1e-6))))
    if not np.isfinite(worst) or THRUST[0] < worst < THRUST[1]:
        return ""
    return (
        f"the accelerometer shows {worst:.2f} times the thrust that the model makes of PWM and"
        " voltage, where 1 is expected; likeliest the model is another craft's (fit one to this"
        " one), or PWM or battery voltage have another unit or scale"
    )


def _powers(run: Run, motion: Motion) -> list[tuple[Array, Array, Array]]:
    """For each stretch in the air: products (lags, 4, 4) of squared rotor speeds with themselves
    and (lags, 4, 2) with roll and pitch acceleration, whose energy is (lags, 2)."""
    from scipy.signal import butter, sosfiltfilt

    top = min(BAND_HZ[1], 0.4 / run.period_s)
    band = butter(3, (BAND_HZ[0], top), "bandpass", fs=1.0 / run.period_s, output="sos")
    found = []
    for first, last in spans(motion.flown):
        if (last - first) * run.period_s < LEAST_SPAN_S:
            continue
        slope = np.gradient(run.gyro[first:last, :2], run.period_s, axis=0)
        answer = sosfiltfilt(band, slope, axis=0)
        square = sosfiltfilt(band, motion.squares.end[first:last], axis=0)
        rows = len(square)
        parts = []
        for lag in np.linspace(0, round(LATEST_S / run.period_s), LAGS).round().astype(int):
            late, early = answer[lag:], square[: rows - lag]
            parts.append((early.T @ early, early.T @ late, (late**2).sum(axis=0)))
        found.append(tuple(np.array(part) for part in zip(*parts, strict=True)))
    return found  # type: ignore[return-value]


def _answer(one: Hypothesis, squares: Array, answers: Array, energy: Array) -> Answer:
    mixer = one.mixer
    torque = np.einsum("ai,ij,aj->a", mixer, squares, mixer)
    both = np.einsum("ai,ia->a", mixer, answers)
    explained = np.sign(both) * both**2 / np.maximum(torque * energy, 1e-300)
    return Answer(explained, both / np.maximum(torque, 1e-300))


def _correlation(one: Array, other: Array) -> float:
    a, b = one - one.mean(), other - other.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else 0.0
