"""A resumable bench's ``results.jsonl``: a line a case, of which the last one counts."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
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


def run_cases(
    cases: Sequence[str],
    results: Path,
    jobs: int,
    work: Callable[[str], Line],
    cells: Callable[[Line], list[str]],
) -> list[Line]:
    """The lines of these cases: those without one are worked on, and told as they come."""
    results.mkdir(parents=True, exist_ok=True)
    done = judged(results)
    with ThreadPoolExecutor(jobs) as pool:
        begun = [pool.submit(work, case) for case in cases if case not in done]
        for line in (one.result() for one in as_completed(begun)):
            append(results, line)
            print(" | ".join(cells(line)), file=sys.stderr, flush=True)
    return [line for line in read_results(results) if line["case"] in cases]


def rows(
    titles: Sequence[str], lines: Sequence[Line], cells: Callable[[Line], list[str]]
) -> Iterator[str]:
    """A Markdown table, a row a case."""
    yield f"| {' | '.join(titles)} |"
    yield "|---" * len(titles) + "|"
    for line in lines:
        yield f"| {' | '.join(cells(line))} |"


def _path(results: Path) -> Path:
    return results / "results.jsonl"
