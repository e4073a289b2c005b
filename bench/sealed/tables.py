"""The tables of docs/discrepancy.md, in Markdown, from a folder of results."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Any

import numpy as np

from bench.sealed.hidden import LISTED
from bench.sealed.judge import LOUD

Line = dict[str, Any]


def tables(lines: list[Line]) -> str:
    """Every table that the results have cases for."""
    parts = [_rates(lines), _by_name(lines), _confusion(lines), _proof(lines), _power(lines)]
    return "\n\n".join(part for part in parts if part)


def _rates(lines: list[Line]) -> str:
    rows = [
        "| cases | mode | right | of | left out | false names | refused or failed |",
        "|---|---|---|---|---|---|---|",
    ]
    groups: dict[tuple[str, str], list[Line]] = defaultdict(list)
    for line in lines:
        groups[_group(line), _mode(line)].append(line)
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
    present = [c for c in columns if any((_group(x), _mode(x)) == c for x in lines)]
    if not present:
        return ""
    head = " | ".join(f"{group}, {mode}" for group, mode in present)
    rows = [f"| hidden | {head} |", "|---" * (len(present) + 1) + "|"]
    for name in LISTED:
        cells = []
        for column in present:
            some = [x for x in lines if (_group(x), _mode(x)) == column and _names(x) == [name]]
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
            if _names(line) == [name] and line["counted"] and not line["right"]:
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
    rows = ["| figure | measured | cases |", "|---|---|---|"]
    some = [x for x in lines if x["counted"] and x["right"] and _group(x) in ("single", "noise")]
    explained = [x["explained"] for x in some if x.get("explained") is not None]
    if explained:
        share = np.mean(np.array(explained) >= 0.9)
        rows.append(
            f"| explained part, median ({share:.0%} of the cases reach 0.9) |"
            f" {np.median(explained):.3f} | {len(explained)} |"
        )
    inside = [p["inside"] for x in some for p in x["parameters"]]
    if inside:
        rows.append(
            f"| true parameter in the 95 % interval | {np.mean(inside):.0%} | {len(inside)} |"
        )
    white = [x["residual"] == "white" for x in some if "residual" in x]
    if white:
        rows.append(f"| residual white with the effect in | {np.mean(white):.0%} | {len(white)} |")
    pointed = [x["where_right"] for x in some]
    if pointed:
        rows.append(
            f"| top `where` row in a channel of what is hidden | {np.mean(pointed):.0%} |"
            f" {len(pointed)} |"
        )
    flights = [x.get("flown") for x in some if "flown" in x or "not_flown" in x]
    if flights:
        closer = [f is not None and f["improved"] < f["base"] for f in flights]
        ratio = np.median([f["improved"] / max(f["base"], 1e-9) for f in flights if f])
        rows.append(
            f"| flying the improved model comes closer (median distance x {ratio:.2f}) |"
            f" {np.mean(closer):.0%} | {len(closer)} |"
        )
    loud = [x for x in lines if _group(x) == "outside" and x.get("loudness", 0) > LOUD]
    if loud:
        said = [x["verdict"] == "unexplained" and x["where_right"] for x in loud]
        rows.append(
            f"| outside the list, gap over 2: `unexplained`, right channel first |"
            f" {np.mean(said):.0%} | {len(said)} |"
        )
    times = [x["seconds"] for x in lines if "seconds" in x]
    if times:
        rows.append(
            f"| seconds a case, median and 95th percentile | {np.median(times):.1f},"
            f" {np.percentile(times, 95):.1f} | {len(times)} |"
        )
    return "\n".join(rows) if len(rows) > 2 else ""


def _power(lines: list[Line]) -> str:
    parts = []
    for group in ("power", "power_noise"):
        some = [x for x in lines if _group(x) == group]
        if not some:
            continue
        levels = sorted({_sigmas(x) for x in some})
        head = " | ".join(f"{level:g} sigma" for level in levels)
        rows = [
            f"| named rightly, {group} | {head} | size at 5 sigma |",
            "|---" * (len(levels) + 2) + "|",
        ]
        for name in LISTED:
            mine = [x for x in some if _names(x) == [name]]
            if not mine:
                continue
            cells = []
            for level in levels:
                here = [x["right"] and bool(x["found"]) for x in mine if _sigmas(x) == level]
                cells.append(f"{sum(here)}/{len(here)}" if here else "")
            rows.append(f"| `{name}` | {' | '.join(cells)} | {_size_at_five(name, mine)} |")
        parts.append("\n".join(rows))
    return "\n\n".join(parts)


def _size_at_five(name: str, lines: list[Line]) -> str:
    """Geometric mean of the sizes scaled to five standard errors."""
    sizes = []
    for line in lines:
        found = line.get("significance", {}).get(name)
        values = {
            k: v for k, v in line["hidden"].get(name, {}).items() if k not in ("rotor", "height_m")
        }
        if not found or not values:
            continue
        if name == "gyro_low_pass":
            sizes.append(values["bandwidth_hz"] * found / 5.0)
        elif name == "motor_braking_asymmetry":
            sizes.append(abs(1.0 - values["factor"]) * 5.0 / found)
        else:
            sizes.append(float(np.linalg.norm(list(values.values()))) * 5.0 / found)
    return f"{np.exp(np.mean(np.log(sizes))):.2g}" if sizes else ""


def _group(line: Line) -> str:
    return str(line["case"]).split(":")[0]


def _names(line: Line) -> list[str]:
    hidden = str(line["case"]).split(":")[1]
    return [] if hidden == "nothing" else hidden.split("+")


def _mode(line: Line) -> str:
    return str(line["case"]).split(":")[3]


def _sigmas(line: Line) -> float:
    return float(str(line["case"]).split(":")[4])
