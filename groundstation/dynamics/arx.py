"""ARX polynomials as simulators (thesis eq. 7.9, 7.32-7.34)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.dynamics.model import ArxAxis

Array = NDArray[np.float64]


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


def poles(axis: ArxAxis) -> NDArray[np.complex128]:
    """Roots of A(z), largest magnitude first; outside the unit circle is unstable."""
    roots = np.roots([1.0, *axis.a]).astype(np.complex128)
    return roots[np.argsort(-np.abs(roots))]
