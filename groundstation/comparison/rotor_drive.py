"""Flights whose rows do not tell how fast their rotors turned, though speeds were recorded.

Where a controller swings the settings from row to row, motors coast in between and a row holds one
of several settings. Predictions, which are driven by PWM and battery voltage, then have torques
that no rotor made.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundstation.comparison.regimes import Motion
from groundstation.dynamics.craft import craft_of_model
from groundstation.dynamics.model import Model, model_vehicle
from groundstation.dynamics.registry import EFFECTS, ROTORS_TURN_BY
from groundstation.dynamics.simulation import duties_for
from groundstation.dynamics.vehicle import MIXERS
from groundstation.identification.runs import Run, measured_squares, without_gaps
from groundstation.telemetry.arrays import Array

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
