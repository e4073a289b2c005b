"""ARX polynomials as simulators (thesis eq. 7.9, 7.32-7.34)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.model import ArxAxis, Model
from groundstation.dynamics.origin import FITTED, origin_of
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES, Array

SLOPE_ROWS = 2
"""An angle's slope is taken over so many rows: the firmware refreshes it every second one."""
Turning = Literal["body", "arx"]
"""What of a model turns the craft: the equations of its body, or its ARX polynomials."""


def turning_of(model: Model, said: str | None = None) -> Turning:
    """What turns the craft: as a user says, else ARX polynomials of all axes that were fitted.

    Raises BadInputError for a word that is neither, or polynomials that the model lacks.
    """
    whole = model.arx is not None and set(AXES) <= set(model.arx)
    if said is None:
        return "arx" if whole and origin_of(model)["arx"] == FITTED else "body"
    if said == "arx" and not whole:
        has = ", ".join(model.arx or {}) or "none"
        raise BadInputError(
            f"attitude arx: the model has ARX polynomials of {has}, all of {', '.join(AXES)} are"
            " needed; fit them: groundstation fit arx"
        )
    if said not in ("body", "arx"):
        raise BadInputError(f"attitude {said}: there are body, arx")
    return "arx" if said == "arx" else "body"


def of_rates(model: Model) -> bool:
    """Whether the polynomials give body rates (``fit arx --gyro``) and not angles."""
    return model.fit.get("arx", {}).get("channel") == "gyro"


def arx_labels(model: Model) -> str:
    """The structures of all axes as the thesis writes them."""
    found = (model.arx or {}).items()
    return ", ".join(f"{axis} ARX({one.na},{one.nb},{one.nk})" for axis, one in found)


def simulate_arx(axis: ArxAxis, inputs: ArrayLike, past_outputs: ArrayLike = ()) -> Array:
    """Outputs (k,) of a free run: the model hears its inputs and its own outputs only.

    inputs: (k,) mixer outputs u' in (rev/s)^2; what came before them is taken as zero.
    past_outputs: up to ``na`` outputs (rad) before the first, oldest first, otherwise zero.
    """
    from scipy.signal import lfilter, lfiltic

    inputs = np.asarray(inputs, np.float64)
    past = np.asarray(past_outputs, np.float64)[::-1][: axis.na]
    denominator = np.array([1.0, *axis.a])
    numerator = np.concatenate([np.zeros(axis.nk), axis.b])
    state = lfiltic(numerator, denominator, past)
    outputs, _ = lfilter(numerator, denominator, inputs, zi=state)
    return np.asarray(outputs)


def arx_ahead(
    axis: ArxAxis, inputs: Array, outputs: Array, starts: NDArray[np.int64], rows: int, every: int
) -> Array:
    """Outputs (m, rows + 1) from each of ``starts`` (m,) to ``rows`` rows later.

    Each free run begins with the measured ``outputs`` (n,) up to its start, which is column 0, and
    is driven by ``inputs`` (n,). every: rows per step of the model, over which the inputs are
    means that end with their row; between steps the output moves on a straight line. What would
    lie before the first row repeats it.
    """
    steps = -(-rows // every)
    known = max(axis.na, 1)
    run = np.empty((len(starts), known + steps))
    for i in range(known):
        run[:, known - 1 - i] = outputs[np.maximum(starts - i * every, 0)]
    for j in range(1, steps + 1):
        at, value = known - 1 + j, np.zeros(len(starts))
        for i, a in enumerate(axis.a, 1):
            value -= a * run[:, at - i]
        for k, b in enumerate(axis.b):
            acted = starts + (j - axis.nk - k) * every
            value += b * inputs[np.clip(acted, 0, len(inputs) - 1)]
        run[:, at] = value
    place = np.arange(rows + 1) / every
    before = np.minimum(place.astype(np.int64), steps - 1)
    share = place - before
    run = run[:, known - 1 :]
    return (1.0 - share) * run[:, before] + share * run[:, before + 1]


def angle_polynomial(model: Model, axis: str) -> ArxAxis:
    """One axis from u' to its angle, of a model whose polynomials give angles or rates.

    Rates are integrated by the trapezoidal rule; body rates count as Euler rates (thesis 3.54).
    """
    one = (model.arx or {})[axis]
    return _integral(one) if of_rates(model) else one


def stacked(axes: Sequence[ArxAxis]) -> tuple[Array, Array, NDArray[np.int64]]:
    """a (m, na), b (m, nb), the shorter filled with zeros, and nk (m,)."""
    a = np.zeros((len(axes), max((one.na for one in axes), default=0)))
    b = np.zeros((len(axes), max((one.nb for one in axes), default=0)))
    for i, one in enumerate(axes):
        a[i, : one.na], b[i, : one.nb] = one.a, one.b
    return a, b, np.array([one.nk for one in axes], np.int64)


def _integral(axis: ArxAxis) -> ArxAxis:
    a = np.convolve([1.0, *axis.a], [1.0, -1.0])[1:]
    b = 0.5 * axis.ts * np.convolve(axis.b, [1.0, 1.0])
    return ArxAxis(len(a), len(b), axis.nk, tuple(a.tolist()), tuple(b.tolist()), axis.ts)


def poles(axis: ArxAxis) -> NDArray[np.complex128]:
    """Roots of A(z), largest magnitude first; outside the unit circle is unstable."""
    roots = np.roots([1.0, *axis.a]).astype(np.complex128)
    return roots[np.argsort(-np.abs(roots))]
