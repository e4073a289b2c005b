"""How strongly each rotor shakes the craft, one flight at a time, by recorded speeds.

The program's own estimate (``groundstation.discrepancy.vibration``) with the profile's inertia:
what flights that share nothing agree on is the craft's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from bench.real.sets import PAYLOAD, SETS
from groundstation.discrepancy.vibration import SIZES, shaking_of, shares_of, windows_of
from groundstation.dynamics.model import vehicle_model
from groundstation.dynamics.vehicle import load_vehicle
from groundstation.errors import BadInputError
from groundstation.identification.flight import prepare
from groundstation.identification.likelihood.frame import Frame
from groundstation.identification.likelihood.parameters import point_of
from groundstation.identification.likelihood.rotors import spin_rotors
from groundstation.identification.recordings import flights_of
from groundstation.recording.open_recording import open_recording

WORTH = 20.0
"""Drop of -2 log L from which there is anything to tell rotors apart by."""


def table(data: Path) -> Iterator[str]:
    """A line for each flight: sizes of M1..M4 with standard errors, and the clock."""
    yield ""
    yield f"| flight | rotors turn faster than recorded, % | {' M1..M4 | '.join(SIZES)} M1..M4 |"
    yield "|---|---|---|---|"
    for folder, profile, names in _sets():
        for name in names:
            path = data / folder / name
            if path.is_file():
                yield from _line(f"{folder}/{name}", path, profile)


def _sets() -> Iterator[tuple[str, str, Sequence[str]]]:
    for one in SETS:
        if one.measured:
            names = {name for split in one.splits for name in (*split.fitted, *split.held)}
            yield one.folder, one.vehicle, sorted(names)
    yield "imrc_payload", SETS[0].vehicle, PAYLOAD


def _line(label: str, path: Path, profile: str) -> Iterator[str]:
    vehicle = load_vehicle(profile)
    frame, point = Frame(vehicle), point_of(vehicle_model(vehicle))
    corners = vehicle.gyro_filter_hz, vehicle.accelerometer_filter_hz
    try:
        flights = prepare(flights_of(open_recording(path).samples, path.name))
    except BadInputError as refused:
        yield f"| {label} | refused: {refused} | | |"
        return
    craft = frame.craft(point)
    cut = (windows_of(one, spin_rotors(one, point, frame).end, craft, corners) for one in flights)
    windows = [one for one in cut if one is not None]
    shares = shares_of(windows, WORTH)
    shaking = shaking_of(windows, shares)
    sizes = []
    for kind in range(len(SIZES)):
        pairs = (shaking.size(kind, rotor) for rotor in range(4))
        sizes.append(", ".join(f"{size:.2g} +- {error:.1g}" for size, error in pairs))
    yield f"| {label} | {100.0 * shares.mean():.1f} | {sizes[0]} | {sizes[1]} |"
