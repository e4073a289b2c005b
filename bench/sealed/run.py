"""Cases through the search: make, search in another process, open the seal, judge."""

from __future__ import annotations

import fcntl
import json
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from bench.command import run_command
from bench.results import append, judged, read_results
from bench.sealed.cases import Case, named
from bench.sealed.flights import Generator, Sealed, vehicle_of
from bench.sealed.judge import judge
from groundstation.fleet.engine import carried_out


def search_arguments(folder: Path) -> list[str]:
    """What the installed command gets for a case's folder."""
    recordings = [str(path) for path in sorted(folder.glob("fit*.mcap"))]
    return [
        *("discrepancy", *recordings, "--model", str(folder / "model.json")),
        *("--validate", str(folder / "validate.mcap"), "--vehicle", vehicle_of(folder)),
        *("-o", str(folder / "improved.json"), "--json", str(folder / "report.json")),
    ]


@dataclass(frozen=True, slots=True)
class Carried:
    """What came of a case: its line, what was hidden and said, None where that failed."""

    line: dict[str, Any]
    opened: str | None


def run(
    cases: Iterable[Case], results: Path, workers: int, keep: bool = False
) -> Iterator[dict[str, Any]]:
    """Judge every case that ``results`` does not hold yet, and append it there; what failed is
    tried again.

    results: a folder, with ``results.jsonl``, what was hidden and said in every case
    (``opened/``), and the base models' families. keep: leave the folders of wrong cases there.
    """
    results.mkdir(parents=True, exist_ok=True)
    done = judged(results)
    left = [case for case in cases if case.name not in done]
    work = partial(carried, results=results.absolute(), keep=keep)
    arriving = carried_out(work, left, workers=workers, largest=1)
    for case, came in arriving:
        line = _failed(case, "its process dies, again and again") if came is None else came.line
        if came is not None and came.opened is not None:
            opened = _opened(results, case)
            opened.parent.mkdir(exist_ok=True)
            opened.write_text(came.opened)
        append(results, line)
        yield line


def carried(case: Case, results: Path, keep: bool) -> Carried:
    """One case, for a worker."""
    with tempfile.TemporaryDirectory(prefix="case-", dir=results) as parent:
        folder = Path(parent) / "case"
        came = _judged(case, results, folder)
        if keep and folder.exists() and not came.line["right"]:
            kept = results / "wrong" / case.name.replace(":", "-")
            shutil.rmtree(kept, ignore_errors=True)
            shutil.copytree(folder, kept)
    return came


def judged_again(results: Path) -> list[dict[str, Any]]:
    """The lines of ``results`` by the judge as it is now, from what was hidden and said; the
    file is left as it is."""
    lines = []
    for line in read_results(results):
        case = named(line["case"])
        opened = _opened(results, case)
        if "error" not in line and opened.exists():
            seal, said = json.loads(opened.read_text())
            line = {**line, **judge(case, Sealed(**seal), said)}
        lines.append(line)
    return lines


def _opened(results: Path, case: Case) -> Path:
    return results / "opened" / f"{case.name.replace(':', '-')}.json"


def _judged(case: Case, results: Path, folder: Path) -> Carried:
    sealed: Sealed | None = None
    generator = Generator(results / "families")
    try:
        with (results / "families.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            generator.family(case)
        sealed = generator.make(case, folder)
        ended = run_command(*search_arguments(folder))
        if ended.said:
            raise RuntimeError(ended.said)
    except RuntimeError as error:
        return Carried(_failed(case, str(error), sealed), None)
    said = json.loads((folder / "report.json").read_text())
    opened = json.dumps([asdict(sealed), said])
    line = judge(case, sealed, said)
    line |= {"processor_s": round(ended.seconds, 3), "peak_mb": ended.peak_mb}
    return Carried(line, opened)


def _failed(case: Case, why: str, sealed: Sealed | None = None) -> dict[str, Any]:
    line = {"case": case.name, "group": case.group, "counted": True, "right": False}
    hidden = sealed.hidden if sealed else {}
    return {**line, "hidden": hidden, "condition": case.condition, "error": why}
