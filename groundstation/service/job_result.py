"""What a fit that was a job advises, from the model it wrote."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from groundstation.documents import read_document


class Advice(msgspec.Struct, frozen=True, kw_only=True):
    """What a fit says would make it better: effects to fit along, recorded rotor speeds."""

    effects: list[str] = []
    measured_rotors: bool = False


def advice(model: Path) -> Advice:
    """What the fit of a body advised; nothing where there is no such model."""
    account = _mapping(_mapping(_read(model), "fit"), "body")
    left_out, warnings = (
        list(map(str, found)) if isinstance(found := account.get(key), list) else []
        for key in ("left_out", "warnings")
    )
    measured = any("--measured-rotors" in text for text in warnings)
    return Advice(effects=sorted(left_out), measured_rotors=measured)


def _read(path: Path) -> Mapping[str, Any]:
    try:
        found = msgspec.json.decode(read_document(path))
    except (OSError, ValueError, msgspec.MsgspecError):
        found = None
    return found if isinstance(found, Mapping) else {}


def _mapping(account: Any, name: str) -> Mapping[str, Any]:
    part = account.get(name) if isinstance(account, Mapping) else None
    return part if isinstance(part, Mapping) else {}
