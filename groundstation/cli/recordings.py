"""What a folder of recordings holds, as ``inspect FOLDER`` shows it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from groundstation.cli.terminal import show, show_json


def list_folder(folder: Path, as_json: bool) -> None:
    """Oldest first: when, how long, from which link, how complete."""
    from groundstation.recording.mcap_scan import catalogue

    found = [entry.as_dict() for entry in catalogue(folder)]
    if as_json:
        show_json(found)
        return
    if not found:
        show(f"no recordings in {folder}")
    for entry in found:
        show(_line(entry))


def _line(entry: dict[str, Any]) -> str:
    size = f"{entry['bytes'] / 1e6:8.1f} MB"
    if entry["state"] != "finished":
        hint = "" if entry["state"] == "recording" else "; see 'groundstation recover'"
        return f"{entry['file']:<44} {size}  {entry['state']}{hint}"
    began = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(entry["start_ns"] * 1e-9))
    samples = "" if entry["samples"] is None else f", {entry['samples']} samples"
    part = f", part {entry['part']}" if (entry["part"] or 1) > 1 else ""
    marks = f", {entry['marks']} marks" if entry["marks"] else ""
    return (
        f"{entry['file']:<44} {size}  {began}  {entry['duration_s']:8.1f} s  {entry['link']}"
        f"{samples}{part}{marks}"
    )
