"""What a link tells beside its telemetry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class LinkEvent:
    """Something worth telling the operator and the recording."""

    time_ns: int
    link: str
    kind: str
    """One word: opened, streaming, silent, lost, ended, closed, fault, restart ..."""
    text: str
    details: dict[str, Any] = field(default_factory=dict)


EventSink = Callable[[LinkEvent], None]
