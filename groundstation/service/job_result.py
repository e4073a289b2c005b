"""What a job has found: the lines of its log that say so, and the advice in the model it wrote."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from groundstation.documents import read_document
from groundstation.text import printable

FOUND = {
    "inspect": r"verdict\s+(.*)",
    "fit": r"\s+(\w+)\s+(\S+ \+- \S+)",
    "compare": r"(gap over all channels.*)",
    "discrepancy": r"(\d+\. \w+: .*|changed: .*|no discrepancy|unexplained)",
    "learn": r"((?:search|gains: ).*)",
}
"""Kind of a job -> its lines that say what was found, and which parts of them."""


class Advice(msgspec.Struct, frozen=True, kw_only=True):
    """What a fit says would make it better: effects to fit along, recorded rotor speeds."""

    effects: list[str] = []
    measured_rotors: bool = False


def result(kind: str, lines: Sequence[str]) -> str:
    """In a line; the last one of the log where none says what was found."""
    found = [match for line in lines if (match := re.fullmatch(FOUND.get(kind, "(?!)"), line))]
    told = ", ".join(" ".join(match.groups()) for match in found)
    return printable(told or (lines[-1] if lines else ""))


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
