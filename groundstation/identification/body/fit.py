"""Grey-box identification of the body from closed-loop flights (thesis 7.3.6), and what it
refuses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.dynamics.effect import to_stderr, to_values
from groundstation.dynamics.model import BodyConstants
from groundstation.dynamics.registry import DELAY, EFFECTS
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.body.setup import (
    CONSTANTS,
    GAINS,
    PACE,
    SPIN_UP,
    STEERED_HZ,
    SUPPLY_EFFECTS,
    Setup,
    between_rows,
    blurred,
    certain,
    is_fast,
    open_delay_s,
    reported_name,
    require_known,
    set_up,
    settings_a_row,
    unseen,
    unseen_delay_s,
)
from groundstation.identification.division import Stretch, paced
from groundstation.identification.estimate import Estimates, inverse, sandwich
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.evaluation import BASE_STEPS
from groundstation.identification.likelihood.motion import (
    MOTOR_KEYS,
    SENSOR_LAG,
    Point,
    spin_rotors,
    value,
)
from groundstation.identification.likelihood.spectra import (
    FreeFit,
    Limits,
    Linear,
    cost_of,
    fit_free,
    reweighted,
    smoothed,
    unfitted,
)
from groundstation.identification.runs import Run
from groundstation.telemetry.arrays import AXES, Array

# What is refused, warned of, and worth a hint: before the body fit and after it.


CLEAR = 6.0
"""Standard errors from which an effect that was left out is worth a word."""
HINTS = ("inertia_coupling.fraction", "rotor_gyroscopic_torque.rotor_inertia_kg_m2")
"""Unknowns of effects that every craft has beside the nuisances: a word where they show."""
CROSS_TALK = 0.3
"""Share of an axis's own torque constant that another axis's torque may seem to have."""
TURNED, TURNED_ERRORS = 0.4, 10.0
"""The same where both axes do and the signs are those of a turn, and how many standard errors make
it certain: rotors 45 degrees away give 1."""
WELL_KNOWN, UNKNOWN = 0.05, 0.5
"""Standard errors over the value from which a constant is worth a warning, or a refusal."""
MOVES = 0.1
"""Share of a constant from which its moving with the band is worth a word."""
EVERY_SETTING = "500 rows a second, or rotor speeds"
ALIKE = 0.97
"""Correlation beyond which two estimates are told only together."""


def require_usable(stretches: Sequence[Stretch], vehicle: Vehicle) -> None:
    """Raises BadInputError for mixed rates, and for a torque or a rate that never changes."""
    period = stretches[0].run.period_s
    for stretch in stretches:
        if abs(stretch.run.period_s / period - 1) > 0.01:
            raise BadInputError(
                f"{stretch.run.name}: {1 / stretch.run.period_s:.0f} rows a second, others"
                f" {1 / period:.0f}; the noise model needs one rate: fit them apart"
            )
        torque = stretch.squares.mixed(vehicle.configuration)[stretch.rows]
        turned = np.diff(stretch.run.gyro[stretch.rows], axis=0)
        for axis, name in enumerate(AXES):
            if np.ptp(torque[:, axis]) == 0.0 or np.ptp(turned[:, axis]) == 0.0:
                raise BadInputError(
                    f"{stretch.run.name}: torque or rate about {name} is constant;"
                    " fly, and move all three axes"
                )


def slow_rows(run: Run, shares: Mapping[str, float]) -> list[str]:
    """A warning where rows come slower than the controller moves the motors, otherwise nothing.

    shares: of ``certainty.between_rows``.
    """
    if not shares:
        return []
    share = max(size for name, size in shares.items() if name in GAINS)
    return [
        f"{1 / run.period_s:.0f} rows a second hold one in {settings_a_row(run):.2g} of the"
        f" motors' settings: c0 and c1 are uncertain by {100 * share:.0f} % for it where the motor"
        f" was fitted (--model), by more where it was not; record {EVERY_SETTING}"
    ]


def require_told(setup: Setup, point: Point, variances: Array) -> None:
    """A c0 or c1 that may as well be zero is no model, nor is a negative constant. variances: (p,)
    by the likelihood."""
    errors = np.sqrt(variances)
    names = ", ".join(sorted({f.run.name for f in setup.problem.flights}))
    for key in setup.keys:
        if key not in CONSTANTS:
            continue
        axis = "roll and pitch" if setup.tied and key == "c0" else AXES[CONSTANTS.index(key)]
        found, error = point[key], float(errors[setup.keys.index(key)])
        unclear = not np.isfinite(found) or error > UNKNOWN * abs(found)
        if unclear and key == "c2":
            continue  # figures of eight hardly turn the craft about yaw: not identified
        if unclear and blurred(setup.problem.flights):
            raise BadInputError(
                f"{names}: torque does not show in the rate about {axis} (its constant is"
                f" {found:.3g} +- {error:.2g}): measured rotor speeds are noisy; fly longer and"
                " move that axis more, or fit without --measured-rotors"
            )
        if unclear:
            raise BadInputError(
                f"{names}: torque does not show in the rate about {axis} (its constant is"
                f" {found:.3g} +- {error:.2g}); was the craft free to turn, and is the"
                " vehicle profile the right one?"
            )
        if found <= 0.0:
            raise BadInputError(
                f"{names}: {key} came out negative ({found:.3g} +- {error:.2g}): the craft turns"
                f" against the torque about {axis}; motors, axes or configuration are not those"
                " of the vehicle profile"
            )


def untold(
    estimates: Estimates,
    moves: Mapping[str, float],
    missed: Mapping[str, float],
    flights: Sequence[Flight],
) -> dict[str, str]:
    """c2 where it is not identified, with the reason. missed: of ``certainty.between_rows``.

    Raises BadInputError where c0 or c1 is not: without them there is no model.
    """
    found = {}
    for name, size, error in zip(estimates.names, estimates.values, estimates.stderr, strict=True):
        if name not in CONSTANTS or error <= UNKNOWN * abs(size):
            continue
        axis, move = AXES[CONSTANTS.index(name)], moves.get(name, 0.0)
        reason = f"{axis} is hardly excited: {size:.3g} +- {error:.2g}"
        if move > 0.5 * error:
            much = "more than its size" if move > abs(size) else f"{100 * move / abs(size):.0f} %"
            reason = (
                f"it moves by {much} with the band of frequencies it is estimated in, so something"
                f" else turns {axis}"
            )
        if missed.get(name, 0.0) > UNKNOWN:
            reason = (
                f"{settings_a_row(flights[0].run):.2g} settings of the motors pass in each row, so"
                f" one that alternates looks like one that lasts: {size:.3g} +- {error:.2g}"
            )
        if name != "c2" and error**2 - move**2 <= (UNKNOWN * size) ** 2:
            continue  # a cut band is biased in closed loop where little is excited: warned of
        if name != "c2":
            names = ", ".join(sorted({f.run.name for f in flights}))
            raise BadInputError(f"{names}: {name} is not identified, because {reason}")
        found[name] = reason
    return found


def unidentified(reasons: Mapping[str, str]) -> list[str]:
    """A warning for each constant that is not identified, with the reason."""
    return [
        f"{name} is not identified, because {reason}; the model has the profile's"
        for name, reason in reasons.items()
    ]


def given_way(whole: Point, point: Point, flights: Sequence[Flight]) -> list[str]:
    """A warning where c0 and c1 are not those of all frequencies: what these say instead."""
    off = [whole[key] / point[key] - 1.0 for key in GAINS]
    if not any(off):
        return []
    low, high = STEERED_HZ
    reason = (
        "measured rotor speeds are too noisy or too slow above"
        if flights[0].rotor_measured
        else "rows do not show every setting of the motors, which counts above"
    )
    return [
        f"c0 and c1 are those of {low:g} to {high:g} Hz, for {reason}: all frequencies together say"
        f" {100 * off[0]:+.0f} and {100 * off[1]:+.0f} %"
    ]


def unused_speeds(flights: Sequence[Flight]) -> list[str]:
    """A warning where rotor speeds were recorded throughout and the motors' model drove the fit."""
    unused = [
        one for one in flights if not one.rotor_measured and np.isfinite(one.run.rotor_rev_s).all()
    ]
    if len(unused) < len(flights):
        return []
    return [
        "rotor speeds were recorded and are not used: with --measured-rotors c0 and c1 do not"
        " depend on how fast the motors are believed to answer"
    ]


def warnings_of(
    estimates: Estimates, moves: Mapping[str, float], beside: Mapping[str, float]
) -> list[str]:
    """What of the estimates is poorly known, implausible, or told only together. beside: relative
    errors that have a warning of their own."""
    lines = []
    for name, found, error in zip(estimates.names, estimates.values, estimates.stderr, strict=True):
        effect, dot, parameter = name.partition(".")
        if name == "c2" and error > UNKNOWN * abs(found):
            continue
        if moves.get(name, 0.0) > MOVES * abs(found):
            lines.append(
                f"{AXES[CONSTANTS.index(name)]} is hardly excited, or what turns it is not all"
                f" in the model: {name} is uncertain by {100 * error / abs(found):.0f} %, it moves"
                " with the band of frequencies it is estimated in"
            )
        elif name in CONSTANTS and error > np.hypot(WELL_KNOWN, beside.get(name, 0.0)) * abs(found):
            lines.append(
                f"{AXES[CONSTANTS.index(name)]} is hardly excited: {name} is uncertain by"
                f" {100 * error / abs(found):.0f} %; move that axis more"
            )
        elif dot:
            known = EFFECTS[effect].parameter(parameter)
            outside = max(known.low - found, found - known.high, 0.0)
            if outside > 2 * error and abs(found - known.absent) > 2 * error:
                lines.append(
                    f"{name} is {found:.3g} +- {error:.2g} {known.unit}, outside the plausible"
                    f" {known.low:g} to {known.high:g}: something else may be missing"
                )
    correlation = estimates.correlation
    for i, one in enumerate(estimates.names):
        for j, other in enumerate(estimates.names[:i]):
            if "." in one + other and abs(correlation[i, j]) > ALIKE:
                lines.append(
                    f"{other} and {one} are told only together (correlation"
                    f" {correlation[i, j]:+.2f}){_separation(one, other)}"
                )
    return lines


def _separation(one: str, other: str) -> str:
    """What to fly to tell two effects apart, where the catalogue knows."""
    first, second = one.partition(".")[0], other.partition(".")[0]
    for effect, rival in ((first, second), (second, first)):
        for confusion in EFFECTS[effect].confused_with if effect in EFFECTS else ():
            if confusion.other == rival:
                return f"; {confusion.manoeuvre}"
    return ""


def cross_talk(setup: Setup, free: FreeFit) -> dict[str, list[str]]:
    """Axes whose rate answers to another axis's torque as well, with a warning for each: rotors in
    other places.

    Raises BadInputError where roll and pitch answer to each other's torque in opposite senses, as
    they do when the rotors sit a part of a turn away from the profile's.
    """
    vehicle = setup.problem.frame.vehicle
    names = ", ".join(sorted({f.run.name for f in setup.problem.flights}))
    lines: dict[str, list[str]] = {}
    share, clear = np.zeros((3, 3)), np.zeros((3, 3), np.bool_)
    torque = _torques(setup, free)
    for axis, name in enumerate(AXES):
        normal, gradient = np.zeros((3, 3)), np.zeros(3)
        for s, power, left in zip(free.linear.spectra, free.powers, free.left, strict=True):
            if s.channel == axis and s.flight in torque:
                weight = s.weight / np.tile(power, 2)
                columns = torque[s.flight]
                normal += (columns * weight) @ columns.T
                gradient += columns @ (weight * left)
        covariance = inverse(normal)
        gain, error = covariance @ gradient, np.sqrt(np.diag(covariance))
        own = free.point[CONSTANTS[axis]] + gain[axis]
        share[axis], clear[axis] = gain / own, np.abs(gain) > TURNED_ERRORS * error
        found = [
            f"{name} turns with the torque about {AXES[other]} as well"
            f" ({gain[other] / own:+.0%}): is the profile's configuration"
            f" '{vehicle.configuration}' the craft's?"
            for other in {0, 1, 2} - {axis}
            if abs(gain[other]) > max(CROSS_TALK * abs(own), 5 * error[other])
        ]
        if found:
            lines[name] = found
    crossed = share[0, 1] * share[1, 0] < 0 and min(abs(share[0, 1]), abs(share[1, 0])) > TURNED
    if crossed and clear[0, 1] and clear[1, 0]:
        raise BadInputError(
            f"{names}: not flown by a {vehicle.name!r}: roll answers to pitch torque"
            f" ({share[0, 1]:+.0%}) and pitch to roll torque ({share[1, 0]:+.0%}); its rotors do"
            f" not sit in configuration '{vehicle.configuration}': give the right --vehicle"
        )
    return lines


def _torques(setup: Setup, free: FreeFit) -> dict[int, Array]:
    """Flight -> spectra (3, 2 m) of the mixer's u' about each axis."""
    found: dict[int, dict[int, Array]] = {}
    for s in setup.linearise(free.point).spectra:
        key = "c0" if setup.tied and s.channel == 1 else CONSTANTS[s.channel]
        place = np.flatnonzero(s.place == setup.keys.index(key))
        if len(place):
            found.setdefault(s.flight, {})[s.channel] = s.columns[place[0]]
    return {
        flight: np.stack([one[axis] for axis in range(3)])
        for flight, one in found.items()
        if len(one) == 3
    }


def hints(
    setup: Setup, free: FreeFit, nuisances: Mapping[str, tuple[float, float]]
) -> tuple[str, ...]:
    """Effects that were not fitted along although the prediction errors show them clearly."""
    found = [
        key.partition(".")[0]
        for key, (size, error) in nuisances.items()
        if key in (DELAY, SPIN_UP) and size > CLEAR * error
    ]
    there = {one.key for keys in setup.variants for one in keys}
    for key in HINTS:
        if key in there:
            continue
        linear = setup.linearise(free.point, (key,))
        count = len(linear.keys)
        normal, gradient = np.zeros((count, count)), np.zeros(count)
        for s, power in zip(linear.spectra, free.powers, strict=True):
            scaled = s.columns * (s.weight / np.tile(power, 2))
            normal[np.ix_(s.place, s.place)] += scaled @ s.columns.T
            gradient[s.place] += scaled @ s.residual
        covariance = inverse(normal)
        size, error = (covariance @ gradient)[-1], float(np.sqrt(covariance[-1, -1]))
        if abs(size) > CLEAR * error and value(free.point, key) == 0.0:
            found.append(key.partition(".")[0])
    return tuple(found)


# Grey-box identification of the body from closed-loop flights (thesis 7.3.6).
#
# A quadrotor flies in closed loop and its rates are the integral of torque: to simulate it freely
# over a flight would compare a diverging integral with a stabilised one. Here each rate is
# predicted one row ahead, on the likelihood of the search (``likelihood/``), with a noise
# spectrum of each flight's own that is free at every frequency. Several starts; nuisances and
# effects fitted along.


TRIAL_STEP_S, TRIED_S, TRIED_LAG_S = 2e-3, 0.016, 3e-3
"""Delays some ms apart can predict almost equally well: each is tried, the best are followed."""
FOLLOWED = 2
BLOCK_S = 0.5
LEAST_SHARE = 0.1
"""Of what the profile's geometry says, for a gain of a craft that its rotors turn."""
CLEARLY = 20.0
"""Of -2 log L, by which unfiltered rates are likelier than those that the profile says. A delay
stands in for the filter; what the model lacks yet decides between them otherwise."""
PACE_ERRORS = 3.0
"""Standard errors from which a motor is said to answer faster or slower than its constants."""
PACE_OF_CRAFTS, PACE_PER_UNSEEN_S = 0.25, 30.0
"""Logarithms, one standard deviation: of a craft's motors about its profile's, and of the estimate
for each second by which settings may have come unseen. Flights of the software craft, of which rows
hold one setting in five (8 ms unseen), say 0.25, one in two (2 ms) 0.06; single flights of
NanoBench's, which is one craft, 0.21."""


@dataclass(frozen=True, slots=True)
class BodyFit:
    """Outcome of ``fit_body``.

    estimates: c0, c1, c2, thrust_per_mass and one ``effect.parameter`` for each effect.
    nuisances: what was fitted along and is not in the model, by key, with standard errors.
    setup, free: predict with the fit. pace: by which a0, a1, a2 were multiplied, and its relative
    standard error. shown: effects that are clearly there and left out. crossed: axes that another's
    torque turns.
    """

    body: BodyConstants
    estimates: Estimates
    effects: tuple[str, ...]
    nuisances: Mapping[str, tuple[float, float]]
    setup: Setup
    free: FreeFit
    warnings: tuple[str, ...]
    not_identified: Mapping[str, str]
    shown: tuple[str, ...] = ()
    pace: tuple[float, float] = (1.0, 0.0)
    crossed: tuple[str, ...] = ()

    @property
    def point(self) -> Point:
        return self.free.point

    @property
    def saved(self) -> Point:
        """The point of what is saved: the nuisances are zero, but for the sensor's lag, and c2 is
        the profile's where it is not identified."""
        zero = {key: 0.0 for key in self.setup.nuisances if key != SENSOR_LAG}
        return {**self.point, **zero, "c2": self.body.c2}

    @property
    def delay_s(self) -> float:
        """The delay behind the rotors, however it was fitted; otherwise 0."""
        return value(self.point, DELAY)


def fit_body(
    stretches: Sequence[Stretch],
    vehicle: Vehicle,
    effects: Sequence[str] = (),
    tie_roll_pitch: bool = False,
    motor_covariance: Array | None = None,
    motor_known: bool = True,
) -> BodyFit:
    """Estimate c0, c1, c2 and thrust_per_mass from all stretches together.

    effects: names in ``FIT_WITH`` that are known to be there. tie_roll_pitch: c1 = c0, as in the
    thesis. vehicle: configuration, mass, arm, and the ratio of the inertias. motor_covariance:
    (3, 3) of a0, a1, a2; what the motor's uncertainty does to each estimate is added to theirs.
    motor_known: otherwise how fast the motors answer is fitted as well, their steady speeds are
    believed.

    Raises BadInputError for stretches without torque or motion. What the data hardly tell is
    named in ``warnings``.
    """
    require_known(effects)
    if not stretches:
        raise BadInputError("body fit: nothing to fit on; give a longer recording")
    require_usable(stretches, vehicle)
    acting = tuple(name for name in effects if name not in SUPPLY_EFFECTS)
    pace = doubt = 0.0
    if not motor_known and stretches[0].motor is not None:
        pace, doubt = _believed_pace(stretches, vehicle)
        stretches = [paced(one, math.exp(pace)) for one in stretches]
    rotors = range(4 if "rotor_mismatch" in effects else 1)
    plain = set_up(stretches, vehicle, vehicle.thrust_per_mass, ())
    thrust, _ = fit_thrust(plain, plain.start)
    found = []
    for rotor in rotors:
        setup = set_up(stretches, vehicle, thrust, acting, tie_roll_pitch, rotor)
        found.append((setup, likeliest(setup)))
    setup, free = min(found, key=lambda one: one[1].cost)
    if vehicle.gyro_filter_hz > 0.0 and is_fast(stretches[0].run.period_s):
        # Whether a log holds filtered rates depends on the firmware: its likelihood says, where it
        # does so clearly and rows are not so slow that the settings between them blur what is fast.
        raw = setup.unfiltered()
        other = fit_free(raw.linearise, free.point, raw.limits(), white=False)
        if other.cost < free.cost - CLEARLY:
            setup, free = raw, likeliest(raw)
    if doubt:
        motor = np.array([free.point[key] for key in MOTOR_KEYS])
        motor_covariance = doubt**2 * np.outer(motor, motor)
    flights = setup.problem.flights  # slow rows of a known motor tell at all frequencies
    noisy = blurred(flights) or (not motor_known and unseen(flights))
    outcome = _outcome(setup, free, acting, motor_covariance, noisy)
    return replace(outcome, pace=(math.exp(pace), doubt))


def _believed_pace(stretches: Sequence[Stretch], vehicle: Vehicle) -> tuple[float, float]:
    """What of ``motor_pace`` is believed, and its standard error.

    Where rows show every setting of the motors it is the estimate, if that is clearly another
    beside the delay that rows leave open. Otherwise a setting's unseen delay is a bias that no
    likelihood tells: the estimate counts beside the profile's by what either is worth.
    """
    pace, doubt = motor_pace(stretches, vehicle)
    if not (unseen_s := unseen_delay_s(stretches[0].run)):
        doubt = math.hypot(doubt, PACE_PER_UNSEEN_S * open_delay_s(stretches[0].run.period_s))
        return pace if abs(pace) > PACE_ERRORS * doubt else 0.0, doubt
    variance = doubt**2 + (PACE_PER_UNSEEN_S * unseen_s) ** 2
    share = PACE_OF_CRAFTS**2 / (PACE_OF_CRAFTS**2 + variance)
    return share * pace, math.sqrt(share * variance)


def motor_pace(stretches: Sequence[Stretch], vehicle: Vehicle) -> tuple[float, float]:
    """How much faster the motors reach their speeds than their constants say (logarithm), and its
    standard error, from roll and pitch: yaw answers to the change of speed itself."""
    setup = set_up(stretches, vehicle, vehicle.thrust_per_mass, ()).for_pace()
    free = likeliest(setup)
    place = setup.keys.index(PACE)
    return free.point[PACE], float(np.sqrt(inverse(free.normal)[place, place]))


def likeliest(setup: Setup) -> FreeFit:
    """The best of several starts: delays, from white noise and from the vehicle's geometry."""
    limits = setup.limits()
    starts = [setup.start]
    plain = limits.held(setup.keys, (SENSOR_LAG,))
    if DELAY in setup.keys:
        step = max(TRIAL_STEP_S, setup.problem.flights[0].period_s)
        least = limits.low[setup.keys.index(DELAY)]
        delays = np.arange(max(least, -step), TRIED_S, step).tolist()
        linear = setup.linearise(setup.start)
        trials = sorted((_trial(setup, linear, delay, plain), delay) for delay in delays)
        starts = [{**setup.start, DELAY: delay} for _, delay in trials[:FOLLOWED]]
    fits = [fit_free(setup.linearise, point, plain, white=False) for point in starts]
    fits.append(fit_free(setup.linearise, starts[0], plain))
    best = likeliest_that_turns(setup, fits)
    if SENSOR_LAG in setup.keys:
        later = best.point[DELAY] + TRIED_LAG_S if DELAY in setup.keys else 0.0
        point = {**best.point, SENSOR_LAG: TRIED_LAG_S, **({DELAY: later} if later else {})}
        lagging = fit_free(setup.linearise, point, limits, white=False)
        best = likeliest_that_turns(setup, [best, lagging])
    if not setup.tied:
        return best
    return replace(best, point={**best.point, "c1": best.point["c0"]})


def likeliest_that_turns(setup: Setup, fits: Sequence[FreeFit]) -> FreeFit:
    """The likeliest of those whose rotors turn the craft about roll and pitch, if there are any.

    Where rows are a row and more late against each other, each channel in its own way, no torque
    at all may be likelier than one that comes too early: the rest of its sizes is free then.
    """
    least = LEAST_SHARE * np.array(setup.problem.frame.vehicle.body_constants[:2])
    turning = [one for one in fits if one.point["c0"] > least[0] and one.point["c1"] > least[1]]
    return min(turning or fits, key=lambda one: one.cost)


def _trial(setup: Setup, linear: Linear, delay: float, limits: Limits) -> float:
    """-2 log L with the rotors' torques of the start point late by ``delay``, all else at its
    best; the shift is one of phase."""
    now = np.array([value(setup.start, key) for key in setup.keys])
    moved = np.array([key in (*CONSTANTS, SPIN_UP) for key in setup.keys])
    spectra = []
    for s in linear.spectra:
        late = moved[s.place]
        columns = s.columns.copy()
        turn = np.exp(-2j * np.pi * np.split(s.hz, 2)[0] * delay)
        real, imaginary = np.split(columns[late], 2, axis=1)
        shifted = (real + 1j * imaginary) * turn
        columns[late] = np.concatenate([shifted.real, shifted.imag], axis=1)
        residual = s.residual + now[s.place] @ s.columns - now[s.place] @ columns
        spectra.append(replace(s, residual=residual, columns=columns))
    held = limits.held(setup.keys, (DELAY, PACE), now)
    first = smoothed(spectra, [s.residual for s in spectra])
    change, _, powers = reweighted(
        replace(linear, spectra=spectra), first, held.low - now, held.high - now
    )
    left = [s.residual - change[s.place] @ s.columns for s in spectra]
    return cost_of(spectra, powers, left)


def fit_thrust(setup: Setup, point: Point) -> tuple[float, float]:
    """thrust_per_mass and its standard error.

    Plain least squares through the origin, so that the mean counts, which is known best; its
    error allows for slow disturbances (climbs, drag), which a noise model would take for signal.

    Raises BadInputError where no stretch has an accelerometer.
    """
    measured, squares = vertical(setup, point)
    if not len(measured):
        names = ", ".join(sorted({f.run.name for f in setup.problem.flights}))
        raise BadInputError(f"{names}: no accelerometer, so thrust_per_mass cannot be fitted")
    normal = float(squares @ squares)
    found = float(measured @ squares) / normal
    score = squares * (measured - found * squares)
    block = max(round(BLOCK_S / setup.problem.flights[0].period_s), 1)
    sums = np.add.reduceat(score, np.arange(0, len(score), block))
    covariance = sandwich(np.array([[normal]]), sums[:, None])
    return found, float(np.sqrt(covariance[0, 0]))


def vertical(setup: Setup, point: Point) -> tuple[Array, Array]:
    """Measured specific force along z (m/s^2) and the sum of squared rotor speeds behind it."""
    measured, modelled = [], []
    strength = np.array([1.0 + value(point, f"rotor_mismatch.{i}") for i in (1, 2, 3, 4)])
    for flight in setup.problem.flights:
        if flight.has_accelerometer:
            late = np.arange(flight.first, flight.last) - value(point, DELAY) / flight.period_s
            total = spin_rotors(flight, point, setup.problem.frame).end ** 2 @ strength
            measured.append(flight.run.accelerometer[flight.rows, 2])
            modelled.append(np.interp(late, np.arange(len(total)), total))
    if not measured:
        return np.empty(0), np.empty(0)
    return np.concatenate(measured), np.concatenate(modelled)


def _outcome(
    setup: Setup,
    free: FreeFit,
    effects: tuple[str, ...],
    motor_covariance: Array | None,
    noisy: bool,
) -> BodyFit:
    keys, size = setup.keys, len(setup.keys)
    if not noisy:  # a band tells where all frequencies may not
        require_told(setup, free.point, np.diag(inverse(free.normal)))
    known = certain(setup, free, noisy)
    require_told(setup, known.point, known.alone)
    free, whole = _moved_to(setup, free, known.point), free.point
    point, moves = free.point, known.moves
    covariance = np.zeros((size + 1, size + 1))
    covariance[:size, :size] = known.covariance
    thrust, thrust_error = fit_thrust(setup, point)
    missed = between_rows(setup)
    for key in missed.keys() & {*keys}:
        covariance[keys.index(key), keys.index(key)] += (missed[key] * point[key]) ** 2
    covariance[size, size] = thrust_error**2
    if motor_covariance is not None and not setup.problem.flights[0].rotor_measured:
        slopes = _by_motor(setup, free)
        covariance += slopes @ motor_covariance @ slopes.T
    nuisances = {
        key: (value(point, key), float(np.sqrt(covariance[keys.index(key), keys.index(key)])))
        for key in setup.nuisances
    }
    reported = [i for i, key in enumerate(keys) if key not in setup.nuisances] + [size]
    names, found, scale = _reported(setup, {**point, "thrust_per_mass": thrust})
    covariance = covariance[np.ix_(reported, reported)] * np.outer(scale, scale)
    rows = sum(f.last - f.first for f in setup.problem.flights)
    estimates = Estimates(names, found, covariance, rows - size)
    c2, flights, crossed = point["c2"], setup.problem.flights, cross_talk(setup, free)
    reasons = untold(estimates, moves, missed, flights)
    if "c2" in reasons:
        c2 = setup.problem.frame.vehicle.body_constants[2]
    return BodyFit(
        BodyConstants(point["c0"], point["c1"], c2, thrust),
        estimates,
        effects,
        nuisances,
        setup,
        replace(free, point={**point, "thrust_per_mass": thrust}),
        (
            *unidentified(reasons),
            *unused_speeds(flights),
            *given_way(whole, point, flights),
            *warnings_of(estimates, moves, missed),
            *slow_rows(flights[0].run, missed),
            *(line for lines in crossed.values() for line in lines),
        ),
        reasons,
        hints(setup, free, nuisances),
        crossed=tuple(crossed),
    )


def _moved_to(setup: Setup, free: FreeFit, point: Point) -> FreeFit:
    """A fit whose constants are others than where its likelihood is largest: what it leaves."""
    if point == free.point:
        return free
    linear = setup.linearise(point)
    left, powers, cost = unfitted(linear)
    return replace(free, point=point, cost=cost, linear=linear, powers=powers, left=left)


def _by_motor(setup: Setup, free: FreeFit) -> Array:
    """How the estimates (p + 1) move with the motor's a0, a1, a2: (p + 1, 3)."""
    linear = setup.linearise(free.point, MOTOR_KEYS)
    count, size = len(linear.keys), len(setup.keys)
    normal = np.zeros((count, count))
    for s, power in zip(linear.spectra, free.powers, strict=True):
        scaled = s.columns * (s.weight / np.tile(power, 2))
        normal[np.ix_(s.place, s.place)] += scaled @ s.columns.T
    slopes, now, thrust = -inverse(normal[:size, :size]) @ normal[:size, size:], free.point, []
    for key in MOTOR_KEYS:
        step = BASE_STEPS[key] * now[key]
        moved = fit_thrust(setup, {**now, key: now[key] + step})[0]
        thrust.append((moved - fit_thrust(setup, now)[0]) / step if step else 0.0)
    return np.vstack([slopes, thrust])


def _reported(setup: Setup, point: Point) -> tuple[tuple[str, ...], Array, Array]:
    """Names and values as models hold them, and the derivative of each by the fit's own."""
    names = [key for key in setup.keys if key in CONSTANTS]
    found, scale = [point[key] for key in names], [1.0 for _ in names]
    for keys in setup.variants:
        values = to_values(keys, point)
        slopes = to_stderr(keys, point, {one.key: 1.0 for one in keys})
        for one in keys:
            names.append(reported_name(one))
            found.append(values[one.parameter.name])
            falls = one.parameter.unknown is not None
            scale.append(-slopes[one.parameter.name] if falls else slopes[one.parameter.name])
    names.append("thrust_per_mass")
    return tuple(names), np.array([*found, point[names[-1]]]), np.array([*scale, 1.0])
