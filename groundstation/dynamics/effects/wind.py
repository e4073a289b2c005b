"""What pushes and turns the craft slowly and belongs to no flight condition: w' = -w / time.

Moving air, a battery that has shifted, a propeller that bends: a force and a moment of which only
the size and the pace are known. Nobody can foresee them, but an observer that knows how large they
are and how fast they change follows them, and they last beyond a prediction. As a first-order
Gauss-Markov process (Gelb, Applied Optimal Estimation, 1974): standard deviation and time constant.
"""

from __future__ import annotations

from typing import Any

from groundstation.dynamics.effect import FORCE, GYRO, STEADY, Effect, Parameter, State


def law(values: Any, craft: Any, body: Any, state: Any) -> Any:
    """Angular and linear acceleration that it adds, and the slopes of both."""
    p, q, r, x, y, z = state
    pace = -1.0 / values[6]
    slopes = (pace * p, pace * q, pace * r, pace * x, pace * y, pace * z)
    return (p, q, r), (x, y, z), slopes


def _size(name: str, unit: str, default: float, high: float) -> Parameter:
    return Parameter(name, unit, default=default, low=0.0, high=high, least=0.0)


SIZES = (
    *(_size(f"moment_{axis}", "rad/s^2", 1.0, 50.0) for axis in "xyz"),
    *(_size(f"force_{axis}", "m/s^2", 0.1, 3.0) for axis in "xyz"),
)

EFFECT = Effect(
    name="wind",
    stage="body",
    law=law,
    order=11,  # it scales with nothing: neither with the mass nor with a load
    states=tuple(State(f"of {one.name}", noise=one.name) for one in SIZES),
    parameters=(
        *SIZES,
        Parameter(
            "time_s", "s", default=2.0, low=0.2, high=60.0, absent=2.0, kind="shape", least=0.05
        ),
    ),
    adds="a moment and a force that drift slowly, with this spread and pace; an observer follows",
    signature="the craft leans or turns against something that no flight condition explains",
    excited_by="nothing special; hover for a minute, again in still air",
    channels=(*GYRO, *FORCE),
    regimes=STEADY,
)
