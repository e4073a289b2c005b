"""``python docs/make_pictures.py [viewer] [where] [real --data FOLDER]``: the pictures, made anew.

viewer: a stand-in flight in the viewer; needs no display; without a GPU, Debian's
mesa-vulkan-drivers and libvulkan1 draw it. where: the map of where a model and a craft with hidden
effects disagree, and how the gap shrinks as the search names them. real: the slow moments of real
craft, from the flights of ``make bench-real``. Any other name is an error.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import msgspec
import numpy as np

from firmware_sim.craft import StandIn
from firmware_sim.settings import StandInSettings
from groundstation import (
    RawBatch,
    Run,
    decode_all,
    find_discrepancy,
    flights_of,
    load_vehicle,
    open_recording,
    vehicle_model,
)
from groundstation.discrepancy.report_figures import waterfall, where_map
from groundstation.recording.rrd import write_rrd
from groundstation.report.figure import png
from groundstation.viewer.screenshot import hidden_viewer

IMAGES = Path(__file__).parent / "images"
RECORDING = Path(__file__).parents[1] / "recordings" / "stand_in_flight.mcap"
AT_S = 24.0
HIDDEN = {
    "centre_of_gravity_offset": {"x_m": 0.0001},
    "velocity_moment": {"moment": 10.0},
    "rotor_acceleration_torque": {"rotor_inertia_kg_m2": 2e-8},
}
FLIGHT_S = 40.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pictures", nargs="*", choices=[[], "viewer", "where", "real"])
    parser.add_argument("--data", type=Path, help="folder with the real flights")
    options = parser.parse_args()
    chosen = options.pictures or ["viewer", "where"]
    if "real" in chosen:
        if options.data is None:
            parser.error("real needs --data FOLDER")
        save("real_slow.png", slow_picture(options.data))
    if "viewer" in chosen:
        save("viewer.png", viewer_picture(RECORDING, AT_S))
    if "where" in chosen:
        where, gap = search_pictures()
        save("where.png", where)
        save("gap.png", gap)


def save(name: str, picture: bytes) -> None:
    (IMAGES / name).write_bytes(picture)
    print(IMAGES / name)


def slow_picture(data: Path) -> bytes:
    sys.path.insert(0, str(Path(__file__).parents[1]))  # the bench is no part of the package
    from bench.real.slow import picture

    return picture(data)


def viewer_picture(recording: Path, at_s: float) -> bytes:
    """The recording in the viewer, the cursor at a device time."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.rrd"
        write_rrd(open_recording(recording), path)
        with hidden_viewer(path, (1600, 900)) as viewer:
            return viewer.picture(at_s)


def search_pictures() -> tuple[bytes, bytes]:
    """(where a model errs on a craft with hidden effects, the gap as they are named)."""
    model = vehicle_model(load_vehicle("crazyflie1"))
    found = find_discrepancy([flown(3), flown(4)], model, [flown(5)])
    proof = found.proof
    print(", ".join(one.name for one in found.findings.effects), [s[1] for s in proof.steps])
    return (
        png(where_map([("the model given: error over noise", proof.before.places)])),
        png(waterfall(proof.steps)),
    )


def flown(seed: int) -> list[Run]:
    settings = {"plant": "reduced", "seed": seed, "effects": HIDDEN}
    packets, heard_s = StandIn(msgspec.convert(settings, StandInSettings)).advance(FLIGHT_S)
    samples, _ = decode_all(RawBatch(packets, np.rint(heard_s * 1e9).astype(np.int64)))
    return flights_of(samples, f"flight {seed}")


if __name__ == "__main__":
    main()
