"""A plant on a test bench: the compiled pieces of the stand-in, one at a time."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_sim.craft import StandIn, StandInSettings
from firmware_sim.layout import STATE
from firmware_sim.physics import parameters
from firmware_sim.plant import derivative, integrate
from firmware_sim.settings import Loss
from groundstation.compiled import kernel
from groundstation.telemetry.packet import decode, motor_counts

QUIET = {"torque_noise": 0.0, "sensor_noise": 0.0, "loss": Loss(good_loss=0.0), "copies": 1}


@functools.cache
def callable_piece(piece: Any) -> Callable[..., Any]:
    """A piece of a kernel, compiled so that a test can call it by itself."""
    called: Callable[..., Any] = kernel(piece.py_func)
    return called


def plant(**settings: Any) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Parameters and state of a level, silent craft 1000 m up; both of shape (1,)."""
    p = parameters(StandInSettings(**{"plant": "reduced", **settings}))
    for name in ("torque_noise", "force_noise", "gyro_noise", "accel_noise", "angle_noise"):
        p[name] = 0.0
    s = np.zeros(1, STATE)
    s["y"][0, 6] = 1.0
    s["y"][0, 2] = 1000.0
    return p, s


def fly(p: NDArray[np.void], s: NDArray[np.void], seconds: float, chunk_s: float = 0.01) -> None:
    """Integrate with inputs held."""
    step = callable_piece(integrate)
    start = 0.0
    for _ in range(round(seconds / chunk_s)):
        step(p[0], s[0], start, chunk_s)
        start += chunk_s


def slopes(p: NDArray[np.void], s: NDArray[np.void], time_s: float = 0.0) -> NDArray[np.float64]:
    """dy/dt of the state; the specific force is in ``s["force"]``."""
    out = np.zeros(len(s["y"][0]))
    callable_piece(derivative)(p[0], s[0], time_s, s["y"][0], out)
    return out


def rotation(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Body to inertial, written out independently of the plant."""
    w, x, y, z = q
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def rows_of(packets: NDArray[np.uint8]) -> dict[str, NDArray[np.int64]]:
    """Consecutive copies removed, timestamps unwrapped: the packet's integers by name."""
    new = np.concatenate([[True], (packets[1:] != packets[:-1]).any(axis=1)])
    records = decode(packets[new])
    steps = np.diff(records["timestamp"].astype(np.int64)) % 65536
    return {
        "timestamp": np.concatenate([[0], np.cumsum(steps)]) + int(records["timestamp"][0]),
        "battery": records["battery"].astype(np.int64),
        "motors": motor_counts(records[:]).astype(np.int64),
        "gyro": records["gyro"].astype(np.int64),
        "accelerometer": records["accelerometer"].astype(np.int64),
        "angles": records["angles"].astype(np.int64),
        "debug": records["debug"].astype(np.int64),
    }


def craft_after(seconds: float, **settings: Any) -> StandIn:
    """A stand-in that was switched on so long ago."""
    craft = StandIn(StandInSettings(**settings))
    craft.advance(seconds)
    return craft


def tilt_deg(truth: NDArray[np.void]) -> NDArray[np.float64]:
    """How far the craft leans, in each row of what really happened."""
    _, x, y, _ = truth["quaternion"].T
    return np.degrees(np.arccos(1 - 2 * (x * x + y * y)))


def programme(folder: Path, *segments: dict[str, Any]) -> str:
    """The file of a pilot's programme of these segments."""

    def inline(value: Any) -> str:
        if isinstance(value, dict):
            return "{" + ", ".join(f"{key} = {inline(one)}" for key, one in value.items()) + "}"
        if isinstance(value, list):
            return "[" + ", ".join(map(inline, value)) + "]"
        return json.dumps(value)

    path = folder / "programme.toml"
    path.write_text(f'name = "made"\nsegment = {inline(list(segments))}\n')
    return str(path)


def flown(seconds: float, **settings: Any) -> tuple[StandIn, dict[str, NDArray[np.int64]]]:
    """A stand-in after a flight, and its telemetry rows."""
    craft = StandIn(StandInSettings(**settings))
    packets, _ = craft.advance(seconds)
    return craft, rows_of(packets)
