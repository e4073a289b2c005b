"""Tables in Markdown from a folder of results."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.sealed.hidden import LISTED
from bench.sealed.judge import LOUD, VISIBLE

Line = dict[str, Any]


def tables(lines: list[Line]) -> str:
    """Every table that the results have cases for."""
    parts = [_rates(lines), _by_name(lines), _confusion(lines), _proof(lines)]
    return "\n\n".join(part for part in parts if part)


def _rates(lines: list[Line]) -> str:
    rows = [
        "| cases | mode | right | of | left out | false names | refused or failed |",
        "|---|---|---|---|---|---|---|",
    ]
    groups: dict[tuple[str, str], list[Line]] = defaultdict(list)
    for line in lines:
        groups[group_of(line), mode_of(line)].append(line)
    for (group, mode), some in sorted(groups.items()):
        counted = [line for line in some if line["counted"]]
        right = sum(line["right"] for line in counted)
        false = sum(bool(line.get("false")) for line in some)
        failed = sum("error" in line and bool(line["error"]) for line in some)
        rows.append(
            f"| {group} | {mode} | {right} | {len(counted)} | {len(some) - len(counted)}"
            f" | {false} | {failed} |"
        )
    return "\n".join(rows)


def _by_name(lines: list[Line]) -> str:
    columns = [
        ("single", "clean"),
        ("single", "affected"),
        ("noise", "clean"),
        ("noise", "affected"),
        ("faithful_plus", "clean"),
        ("faithful_plus", "affected"),
    ]
    present = [c for c in columns if any((group_of(x), mode_of(x)) == c for x in lines)]
    if not present:
        return ""
    head = " | ".join(f"{group}, {mode}" for group, mode in present)
    rows = [f"| hidden | {head} |", "|---" * (len(present) + 1) + "|"]
    for name in LISTED:
        cells = []
        for column in present:
            some = [
                x for x in lines if (group_of(x), mode_of(x)) == column and names_of(x) == [name]
            ]
            counted = [x for x in some if x["counted"]]
            cells.append(f"{sum(x['right'] for x in counted)}/{len(counted)}" if some else "")
        rows.append(f"| `{name}` | {' | '.join(cells)} |")
    return "\n".join(rows)


def _confusion(lines: list[Line]) -> str:
    """What was said instead, or on top, for every hidden effect of a counted single."""
    rows = []
    for name in LISTED:
        wrong: Counter[str] = Counter()
        for line in lines:
            if names_of(line) == [name] and line["counted"] and not line["right"]:
                for said in line.get("false", []):
                    wrong[f"`{said}`"] += 1
                if line.get("missed") and not line.get("false"):
                    wrong["nothing" if not line.get("found") else "not all of it"] += 1
                if line.get("error"):
                    wrong["refused or failed"] += 1
        if wrong:
            said = ", ".join(f"{other} {count}" for other, count in wrong.most_common())
            rows.append(f"| `{name}` | {said} |")
    if not rows:
        return ""
    return "\n".join(["| hidden | said wrongly (cases) |", "|---|---|", *rows])


def _proof(lines: list[Line]) -> str:
    """What the report claims besides the name; of singles, those that were named rightly."""
    some = [x for x in lines if x["counted"] and x["right"] and group_of(x) in ("single", "noise")]
    explained = np.array([x["explained"] for x in some if x.get("explained") is not None])
    figures: list[tuple[str, Sequence[bool]]] = [
        ("explained part at least 0.9", list(explained >= 0.9)),
        (
            "true parameter in the 95 % interval",
            [p["inside"] for x in some for p in x["parameters"]],
        ),
        ("residual white with the effect in", [x["residual"] == "white" for x in some]),
        ("top `where` row: channel and regime of what is hidden", [x["where_right"] for x in some]),
        (
            "outside the list, gap over 2: `unexplained`, right channel first",
            [
                x["verdict"] == "unexplained" and x["where_right"]
                for x in lines
                if group_of(x) == "outside" and x.get("loudness", 0) > LOUD
            ],
        ),
        (
            "faithful plant: each effect that is there and above five standard errors, found",
            [
                name not in x["missed"]
                for x in lines
                if group_of(x).startswith("faithful") and "missed" in x
                for name, size in x["significance"].items()
                if size >= VISIBLE
            ],
        ),
    ]
    rows = [f"| {what} | {sum(held)} | {len(held)} |" for what, held in figures if len(held)]
    if not rows:
        return ""
    busy = [x["processor_s"] for x in some if "processor_s" in x]
    if busy:
        median, most = np.percentile(busy, (50, 95))
        rows.append(f"| processor time, median {median:.1f} s, 95 % below {most:.1f} s | | |")
    return "\n".join(["| measured | holds | of |", "|---|---|---|", *rows])


def group_of(line: Line) -> str:
    return str(line["case"]).split(":")[0]


def names_of(line: Line) -> list[str]:
    hidden = str(line["case"]).split(":")[1]
    return [] if hidden == "nothing" else hidden.split("+")


def mode_of(line: Line) -> str:
    return str(line["case"]).split(":")[3]
