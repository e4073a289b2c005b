"""Any readable recording, told by its content."""

from __future__ import annotations

from pathlib import Path

from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.file_window import FileWindow
from groundstation.recording.session import Recording

_HEAD_BYTES = 4096
_RRD_MAGIC = (b"RRF2", b"RRF1", b"RRF0", b"RRIO")
_MICROSD_MAGIC = 0xBC


def open_recording(path: Path, *, raw: bool = False, column_map: Path | None = None) -> Recording:
    """Read an MCAP, CSV, microSD or rerun recording, whatever its name ends with.

    raw: also the packets as received, where the file has them.
    column_map: a TOML file that says what the columns of a CSV file mean.

    Raises BadInputError or RecordingError, one line each, where the file does not exist,
    cannot be read, or is nothing that is known here.
    """
    window = FileWindow(path)
    try:
        head = bytes(window.view(0, min(window.size, _HEAD_BYTES)))
    finally:
        window.close()
    if not head:
        raise RecordingError(f"{path}: is empty (0 bytes)")
    if column_map is not None:
        if not _is_text(head):
            raise BadInputError(f"{path}: not a CSV file, so it takes no column map")
        from groundstation.recording.column_map import read_mapped_csv

        return read_mapped_csv(path, column_map)
    return _reader(path, head, raw)


def _reader(path: Path, head: bytes, raw: bool) -> Recording:
    """Each format's reader is loaded only where it is used."""
    from groundstation.recording.mcap_scan import looks_like_mcap

    if looks_like_mcap(head):
        from groundstation.recording.mcap_reader import read_mcap

        return read_mcap(path, raw=raw)
    if head.startswith(_RRD_MAGIC):
        from groundstation.viewer.rrd import read_rrd

        return read_rrd(path)
    if head[0] == _MICROSD_MAGIC:
        from groundstation.recording.microsd import read_microsd

        return read_microsd(path)
    if _is_text(head):
        from groundstation.recording.csv_file import read_csv

        return read_csv(path)
    raise RecordingError(f"{path}: neither MCAP, CSV, a microSD log nor a rerun recording")


def _is_text(head: bytes) -> bool:
    """True for UTF-8 or Latin-1 text, possibly cut inside a character."""
    control = set(range(32)) - {9, 10, 12, 13}
    return not control.intersection(head)
