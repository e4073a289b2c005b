"""What is refused, warned of, and worth a hint: before the body fit and after it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from groundstation.dynamics.registry import DELAY, EFFECTS
from groundstation.dynamics.vehicle import Vehicle
from groundstation.errors import BadInputError
from groundstation.identification.body.certainty import STEERED_HZ, blurred, settings_a_row
from groundstation.identification.body.setup import CONSTANTS, GAINS, SPIN_UP, Setup
from groundstation.identification.estimate import Estimates, inverse
from groundstation.identification.flight import Flight
from groundstation.identification.likelihood.free_spectra import FreeFit
from groundstation.identification.likelihood.parameters import Point, value
from groundstation.identification.runs import Run
from groundstation.identification.stretches import Stretch
from groundstation.telemetry.arrays import AXES, Array

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
