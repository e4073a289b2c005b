"""Any readable recording, told by its content."""

from __future__ import annotations

from pathlib import Path

from groundstation.documents import read_document, seems
from groundstation.errors import BadInputError, RecordingError
from groundstation.recording.file_window import FileWindow
from groundstation.recording.formats import checked, is_text, read_as
from groundstation.recording.ros_bag import is_bag_folder, read_bag
from groundstation.recording.rows import EVERY_ROW, Rows
from groundstation.recording.session import Recording
from groundstation.recording.unread import refuse_unread

_HEAD_BYTES = 4096


def open_recording(
    path: str | Path,
    *,
    raw: bool = False,
    column_map: str | Path | None = None,
    rows: Rows = EVERY_ROW,
) -> Recording:
    """Read an MCAP, CSV or microSD recording, a ROS bag (also its folder), a ULog or a
    Parquet table, whatever its name ends with.

    raw: also the packets as received, where the file has them.
    column_map: what the columns of another program's file mean: the name of a map that ships with
        the program (``column_map.NAMED``), or a TOML file.
    rows: which of a table are read, and how many a second there are where no column says it.

    Raises BadInputError or RecordingError, one line each, where the file does not exist,
    cannot be read, or is nothing that is known here.
    """
    path = Path(path)
    if is_bag_folder(path):
        return checked(read_bag(path, column_map, rows))
    window = FileWindow(path)
    try:
        head = bytes(window.view(0, min(window.size, _HEAD_BYTES)))
    finally:
        window.close()
    if not head:
        raise RecordingError(f"{path}: is empty (0 bytes)")
    if column_map is None or not is_text(head):
        refuse_unread(path, head)
    if head.lstrip()[:1] == b"{":
        raise BadInputError(f"{path}: not a recording{seems(read_document(path))}")
    return read_as(path, head, raw, column_map, rows)
