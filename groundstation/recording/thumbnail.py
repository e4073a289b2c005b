"""A flight at a glance: motors, roll and pitch over the whole recording as a small SVG picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.telemetry.samples import SampleBatch

WIDTH, HEIGHT = 160, 40
COLUMNS = 80
ANGLE_LEAST_DEG = 10.0
"""A flight that leans less does not fill the picture: its noise would look like one that leans."""

_HEAD = f"""\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" \
height="{HEIGHT}"><style>
.motors {{ fill: #9aa7b5; opacity: .45; }} path {{ stroke-width: 1.2; fill: none; }}
.roll {{ stroke: #0060a8; }} .pitch {{ stroke: #b84300; }}
@media (prefers-color-scheme: dark) {{ .roll {{ stroke: #6db3ff; }} .pitch {{ stroke: #ffa061; }} }}
</style>"""


def thumbnail(samples: SampleBatch) -> str:
    """The picture. Motors: mean duty as an area from below. Roll and pitch: in each column from
    the least to the most, about the middle."""
    parts = [_HEAD]
    if len(samples):
        since_s = samples.time_s - samples.time_s[0]
        length_s = max(float(since_s[-1]), 1e-9)
        column = np.minimum((since_s / length_s * COLUMNS).astype(np.intp), COLUMNS - 1)
        motors = _extremes(samples.duty.mean(axis=1), column)[1]
        if np.isfinite(motors).any():
            parts.append(_area(np.nan_to_num(motors)))
        angles = np.degrees(samples.attitude[:, :2])
        if np.isfinite(angles).any():
            most = max(ANGLE_LEAST_DEG, float(np.nanmax(np.abs(angles))))
            for name, values in zip(("roll", "pitch"), angles.T, strict=True):
                parts.append(_strokes(name, *_extremes(values, column), most))
    return "".join([*parts, "</svg>\n"])


def _extremes(
    values: NDArray[np.floating], column: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and most of each column, NaN where nothing is known."""
    least, most = np.full(COLUMNS, np.inf), np.full(COLUMNS, -np.inf)
    known = np.isfinite(values)
    np.minimum.at(least, column[known], values[known])
    np.maximum.at(most, column[known], values[known])
    empty = least > most
    least[empty] = most[empty] = np.nan
    return least, most


def _area(duty: NDArray[np.float64]) -> str:
    points = " ".join(f"{_x(i):g},{HEIGHT * (1 - min(one, 1.0)):.1f}" for i, one in enumerate(duty))
    return f'<polygon class="motors" points="0,{HEIGHT} {points} {WIDTH},{HEIGHT}"/>'


def _strokes(name: str, least: NDArray[np.float64], most: NDArray[np.float64], scale: float) -> str:
    middle, half = HEIGHT / 2, HEIGHT / 2 - 1
    places = [
        f"M{_x(i):g} {middle - half * high / scale:.1f}V{middle - half * low / scale + 0.5:.1f}"
        for i, (low, high) in enumerate(zip(least, most, strict=True))
        if np.isfinite(low)
    ]
    return f'<path class="{name}" d="{"".join(places)}"/>'


def _x(column: int) -> float:
    return (column + 0.5) * WIDTH / COLUMNS
