"""What an .rrd file holds."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from rerun.chunk import RrdReader

SCALARS = "Scalars:scalars"
TEXT = "TextLog:text"


def column(path: Path, component: str) -> dict[str, np.ndarray]:
    """Entity -> the values (n, k) of a component in the order of ``device_time``."""
    found: dict[str, list[tuple[int, np.ndarray]]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a live view that is being saved has no footer yet
        reader = RrdReader(path)
    for chunk in reader.stream() if reader.recordings() else ():
        batch = chunk.to_record_batch()
        if component in batch.schema.names and batch.num_rows:
            values = batch[component].flatten().to_numpy(zero_copy_only=False)
            begins = batch["device_time"][0].value
            entity = chunk.entity_path.replace("\\", "")
            found.setdefault(entity, []).append((begins, values.reshape(batch.num_rows, -1)))
    in_order = {entity: sorted(parts, key=lambda part: part[0]) for entity, parts in found.items()}
    return {
        entity: np.concatenate([values for _, values in parts])
        for entity, parts in in_order.items()
    }
