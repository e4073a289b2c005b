"""What a job has found, in a sentence, from the model it wrote and its log."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from groundstation.documents import read_document
from groundstation.text import printable

LEARNT = ("search", "gains: ")
"""How lines of ``learn`` begin that say what it found."""
_VERDICT = re.compile(r"verdict\s+(.*)")


class Advice(msgspec.Struct, frozen=True, kw_only=True):
    """What a fit says would make it better: effects to fit along, recorded rotor speeds."""

    effects: list[str] = []
    measured_rotors: bool = False


def result(kind: str, model: Path | None, lines: Sequence[str]) -> str:
    """One sentence; the last line of the log where nothing better is known."""
    document = _read(model)
    if kind == "fit" and (said := _constants(document)):
        return said
    if kind == "discrepancy" and document:
        return _effects(document)
    if kind == "inspect":
        for line in lines:
            if found := _VERDICT.match(line):
                return printable(found[1])
    if kind == "learn":
        return printable("; ".join(line for line in lines if line.startswith(LEARNT)))
    if not lines:
        return ""
    return printable(lines[0] if kind == "compare" else lines[-1])


def advice(model: Path | None) -> Advice:
    """What the fit of a body advised; nothing where there is no such model."""
    account = _mapping(_mapping(_read(model), "fit"), "body")
    left_out, warnings = (
        list(map(str, found)) if isinstance(found := account.get(key), list) else []
        for key in ("left_out", "warnings")
    )
    measured = any("--measured-rotors" in text for text in warnings)
    return Advice(effects=sorted(left_out), measured_rotors=measured)


def _constants(document: Mapping[str, Any]) -> str:
    """Of a fit: each constant and its standard error."""
    estimates = _mapping(_mapping(_mapping(document, "fit"), "body"), "estimates")
    columns = (estimates.get(name) or () for name in ("names", "values", "stderr"))
    return ", ".join(f"{name} {value:.4g} ± {error:.2g}"
                     for name, value, error in zip(*columns, strict=False))  # fmt: skip


def _effects(document: Mapping[str, Any]) -> str:
    """Of a search: the effects that the model has now, and their sizes."""
    found = []
    for term in document.get("effects") or ():
        sizes = [
            f"{name} {one['value']:.3g}"
            + (f" ± {one['stderr']:.2g}" if one.get("stderr") is not None else "")
            + (f" {one['unit']}" if one.get("unit") not in (None, "", "1") else "")
            for name, one in _mapping(term, "parameters").items()
        ]
        found.append(f"{term['name']} ({', '.join(sizes)})" if sizes else str(term["name"]))
    changed = _mapping(_mapping(document, "fit"), "discrepancy").get("base_changes") or ()
    constants = [f"{one['name']} {one['from']:.4g} to {one['to']:.4g}" for one in changed
                 if {"name", "from", "to"} <= set(one)]  # fmt: skip
    said = f"the model has {len(found)} effect{'s' if len(found) != 1 else ''} now: " + (
        ", ".join(found)
    ) if found else "no effect found"  # fmt: skip
    return said + (f"; changed: {', '.join(constants)}" if constants else "")


def _read(path: Path | None) -> Mapping[str, Any]:
    try:
        found = msgspec.json.decode(read_document(path)) if path is not None else None
    except (OSError, ValueError, msgspec.MsgspecError):
        found = None
    return found if isinstance(found, Mapping) else {}


def _mapping(account: Any, name: str) -> Mapping[str, Any]:
    part = account.get(name) if isinstance(account, Mapping) else None
    return part if isinstance(part, Mapping) else {}
