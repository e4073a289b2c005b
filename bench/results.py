"""A resumable bench's ``results.jsonl``: a line a case, of which the last one counts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

Line = dict[str, Any]


def read_results(results: Path) -> list[Line]:
    """The lines written so far to a folder."""
    path = _path(results)
    if not path.exists():
        return []
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    return list({line["case"]: line for line in lines}.values())


def judged(results: Path) -> set[str]:
    """Names of the cases that need not be run again; what failed is tried again."""
    return {line["case"] for line in read_results(results) if "error" not in line}


def append(results: Path, line: Line) -> None:
    """Keep a case's line."""
    with _path(results).open("a") as file:
        file.write(json.dumps(line) + "\n")


def _path(results: Path) -> Path:
    return results / "results.jsonl"
