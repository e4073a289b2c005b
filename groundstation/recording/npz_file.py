"""Packets as the stand-in writes them with ``-o NAME.npz``: numpy arrays in a zip file.

``packets`` (n, 32) uint8, every copy as received; ``arrival_s`` (n,), seconds since power-on;
``vehicle``, the craft's name.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.session import Recording
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.packet import PACKET_BYTES
from groundstation.telemetry.samples import RawBatch

MOST_RATIO = 100
"""Unpacked over packed: a craft that lies still, four copies of each packet, has 20."""
_UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    ValueError,
    RuntimeError,  # also what is not implemented
    MemoryError,
    SyntaxError,
    struct.error,
)
"""What zipfile and numpy raise for damaged bytes."""
LONGEST_S = 1e9
"""Whole nanoseconds of it still fit a host stamp."""


def read_npz(path: Path, *, raw: bool = False) -> Recording:
    """Decoded samples, and with ``raw`` the packets as received.

    Raises BadInputError where there is no such file; RecordingError where it holds something
    else, or is damaged: a zip file says nothing of what lies behind a broken place.
    """
    arrays = _arrays(path)
    packets, arrival_s = arrays["packets"], arrays["arrival_s"]
    if packets.dtype != np.uint8 or packets.ndim != 2 or packets.shape[1] != PACKET_BYTES:
        raise RecordingError(
            f"{path}: 'packets' is {packets.dtype} of shape {packets.shape}, must be bytes in rows"
            f" of {PACKET_BYTES}"
        )
    if arrival_s.dtype != np.float64 or arrival_s.shape != packets.shape[:1]:
        raise RecordingError(f"{path}: 'arrival_s' must hold one float64 for each packet")
    if not (np.isfinite(arrival_s) & (np.abs(arrival_s) < LONGEST_S)).all():
        raise RecordingError(f"{path}: 'arrival_s' holds times that no recording can have")
    batch = RawBatch(packets, np.rint(arrival_s * 1e9).astype(np.int64))
    samples, _ = decode_all(batch)
    if len(samples) == 0:
        raise RecordingError(f"{path}: none of its {len(packets)} packets is telemetry")
    metadata = {}
    if arrays["vehicle"].dtype.kind == "U" and arrays["vehicle"].size == 1:
        metadata["vehicle"] = {"profile": str(arrays["vehicle"].item())}
    return Recording(path, "npz", samples, raw=batch if raw else None, metadata=metadata)


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    found: dict[str, NDArray[Any]] = {"vehicle": np.array(0)}
    try:
        with zipfile.ZipFile(path) as file:
            declared = sum(member.file_size for member in file.infolist())
            if declared > MOST_RATIO * path.stat().st_size:
                raise RecordingError(
                    f"{path}: says that it unpacks to {declared / 1e6:.0f} MB, more than"
                    f" {MOST_RATIO} times its size, which telemetry does not"
                )
            for name in ("packets", "arrival_s", "vehicle"):
                if f"{name}.npy" in file.namelist():
                    with file.open(f"{name}.npy") as member:
                        found[name] = np.lib.format.read_array(member, allow_pickle=False)
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror or error}") from None
    except RecordingError:
        raise
    except _UNREADABLE:
        raise RecordingError(f"{path}: damaged, or no numpy file; copy it again") from None
    missing = [name for name in ("packets", "arrival_s") if name not in found]
    if missing:
        raise RecordingError(
            f"{path}: a zip file without {' and '.join(missing)}, so none of the stand-in's"
            " (python -m firmware_sim -o NAME.npz)"
        )
    return found
