"""One series of a log that has many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Series:
    """One series of a log.

    time_ns: (n,) when each row came, in order, on a clock that all series of the file share.
    columns: name -> (n,) numbers.
    type: of its messages, or empty.
    """

    name: str
    time_ns: NDArray[np.int64]
    columns: Mapping[str, NDArray[np.generic]]
    type: str = ""
