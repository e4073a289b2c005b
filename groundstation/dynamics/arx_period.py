"""ARX polynomials of a decimated fit as those of a loop's shorter period.

A slow step's input is the mean over the rows that end with it, so a slow model is one whose input
is held over its step. Its poles are taken to the power 1/every, and the inputs weighed such that an
input that is constant over each step gives the polynomials' own outputs at their steps. Delays are
whole steps, and stay whole rows. Rates of a decimated fit are means over the step as well; the
model between both means is the one without them (``identification/arx/data.py``), half a step less
late than the held one.
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from groundstation.dynamics.arx import of_rates
from groundstation.dynamics.model import ArxAxis, Model
from groundstation.errors import BadInputError

Array = NDArray[np.float64]
FITS = 0.01
"""Periods that differ by less are one period."""
REAL = 1e-9


def at_period(model: Model, period_s: float) -> Model:
    """The model with polynomials that make a step every ``period_s``.

    Raises BadInputError where a step of theirs is no whole number of periods.
    """
    polynomials = model.arx or {}
    if all(abs(one.ts / period_s - 1.0) <= FITS for one in polynomials.values()):
        return model
    rates = of_rates(model)
    faster = {name: _faster(one, name, period_s, rates) for name, one in polynomials.items()}
    return msgspec.structs.replace(model, arx=faster)


def _faster(axis: ArxAxis, name: str, period_s: float, rates: bool) -> ArxAxis:
    every = round(axis.ts / period_s)
    if every < 1 or abs(axis.ts / (every * period_s) - 1.0) > FITS:
        raise BadInputError(
            f"the ARX polynomials of {name} make a step every {1e3 * axis.ts:g} ms, the craft's"
            f" loop every {1e3 * period_s:g} ms, which does not divide it; fit them on other rows"
            " (--decimate), or let the body turn it: attitude body"
        )
    a, weights = _denominator(axis, every)
    inputs = np.zeros((axis.nb - 1) * every + 1)
    inputs[::every] = axis.b
    b, nk = np.convolve(weights, inputs), axis.nk * every
    if rates:
        late = 0.5 * (every - 1)  # in rows
        nk -= int(np.ceil(late))
        share = np.ceil(late) - late
        b = np.convolve(b, [1.0 - share, share] if share else [1.0])
        if nk < 0:
            b, nk = _from_now_on(b, nk), 0
    return ArxAxis(len(a), len(b), nk, tuple(a.tolist()), tuple(b.tolist()), period_s)


def _from_now_on(b: Array, nk: int) -> Array:
    """Weights (m,) of inputs from ``nk`` < 0 on, with those of inputs to come extrapolated from the
    latest two: u', behind the motors, hardly bends within half a step."""
    rows = np.arange(nk, nk + len(b))
    ahead, kept = rows < 0, np.zeros(max(nk + len(b), 2))
    kept[: (~ahead).sum()] = b[~ahead]
    weight, lead = b[ahead].sum(), -(b[ahead] * rows[ahead]).sum()
    kept[:2] += weight + lead, -lead
    return kept


def _denominator(axis: ArxAxis, every: int) -> tuple[Array, Array]:
    """Coefficients from a1 on of the faster 1/A, and its weights (b) of the inputs.

    A pole on the negative axis has no real root: its factor is left as it is, over ``every`` rows.
    """
    from scipy.linalg import expm, logm

    found = np.roots([1.0, *axis.a]) if axis.na else np.zeros(0)
    whole = (found.real <= 0.0) & (np.abs(found.imag) <= REAL)
    slow = np.atleast_1d(np.real(np.poly(found[~whole])))
    order = len(slow) - 1
    fast, weights = np.ones(1), np.full(every, 1.0 / every)
    if order:
        companion = np.vstack([-slow[1:], np.eye(order)[:-1]])
        step = np.real(expm(logm(companion) / every))
        summed = sum(np.linalg.matrix_power(step, i) for i in range(every))
        driven = np.linalg.solve(summed, np.eye(order)[0])
        fast = np.real(np.poly(step))
        answer = [float((np.linalg.matrix_power(step, i) @ driven)[0]) for i in range(order)]
        weights = np.convolve(fast, answer)[:order]
    for pole in found[whole].real:
        fast = np.convolve(fast, [1.0, *np.zeros(every - 1), -pole])
    return fast[1:], weights
