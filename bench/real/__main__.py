"""``python -m bench.real DATA [PART...]``: fits and findings on real flights, judged from outside.

DATA holds imrc/, imrc_brushed/, imrc_payload/ and nanobench/; a set that is not there is left out.
What was computed is kept in ``--results`` and taken again until the program's code changes.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from bench.real import acceptance, program
from bench.real.reference import Flight, explained, read_flight, reference_gain
from bench.real.sets import HERE, PAYLOAD, SETS, FlightSet, Split, drawn
from groundstation.dynamics.model import load_model
from groundstation.dynamics.vehicle import load_vehicle

PARTS = ("fit", "agreement", "find")
ACCEPT = "accept"
"""Pass or fail, a line each, instead of tables; not among what runs by default."""
AXES = {"roll": "c0", "pitch": "c1", "yaw": "c2"}
Case = dict[str, Any]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.real", description=__doc__)
    parser.add_argument("data", type=Path, help="folder with the sets")
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}, or {ACCEPT}"
    )
    parser.add_argument("--only", help="one set: brushless, brushed, nanobench or payload")
    parser.add_argument("--results", type=Path, default=Path("build/bench-real"))
    parser.add_argument(
        "--draw",
        type=int,
        default=0,
        metavar="N",
        help="N splits of each set, drawn from all of its flights, instead of the bench's own",
    )
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn")
    chosen = parser.parse_args()
    parts = chosen.parts or list(PARTS)
    known = (*PARTS, ACCEPT)
    if wrong := [part for part in parts if part not in known]:
        parser.error(f"{', '.join(wrong)} not known; there are {', '.join(known)}")
    chosen.results.mkdir(parents=True, exist_ok=True)
    bench = Bench(chosen.data.absolute(), chosen.results, chosen.only)
    if chosen.draw:
        bench.sets = [drawn(one, bench.data, chosen.seed, chosen.draw) for one in bench.sets]
    for part in parts:
        for line in getattr(bench, part)():
            print(line, flush=True)
    return int(bench.failed)


class Bench:
    """The tables, and the cases behind them, each computed once."""

    def __init__(self, data: Path, results: Path, only: str | None) -> None:
        self.data, self.results, self.only = data, results, only
        self.failed = False
        self.sets = [
            one for one in SETS if (data / one.folder).is_dir() and only in (None, one.name)
        ]
        code = (HERE.parents[1] / "groundstation").rglob("*.py")
        self.code_time = max(path.stat().st_mtime for path in code)

    def fit(self) -> Iterator[str]:
        """c0, c1 beside the reference; what each explains of held-out flights."""
        yield ""
        yield (
            "| set | axis | reference, 4..18 Hz (PWM: 2..20) | fit body | ratio |"
            " explained, 4..18 Hz, held out: reference, program | 50 ms ahead, held out |"
        )
        yield "|---|---|---|---|---|---|---|"
        for flights, split in self._splits():
            case, reference = self.fitted(flights, split), self.reference(flights, split)
            label = f"{flights.name} {split.name}"
            if "refused" in case:
                yield f"| {label} | | | refused: {case['refused']} | | | |"
                continue
            for axis, constant in AXES.items():
                value, error = case["constants"][constant], case["stderr"][constant]
                said = f"{value:.3g}" + (f" +- {error:.1g}" if error else "")
                ahead = case["validation"].get(f"gyro_{axis}_fit_percent_50ms", float("nan"))
                one = reference.get(axis)
                if one is None:
                    yield f"| {label} | {axis} | | {said} | | | {ahead:.0f} % |"
                    continue
                ratio = value * reference["per_constant"] / one["gain"]
                share = self.explained(flights, split, axis, ratio * one["gain"], one)
                yield (
                    f"| {label} | {axis} | {one['gain']:.3g} +- {one['stderr']:.1g} | {said} |"
                    f" {ratio:.2f} | {one['held']:.2f}, {share:.2f} | {ahead:.0f} % |"
                )
            yield (
                f"| {label} | thrust | | {case['constants']['thrust_per_mass']:.4g} | | |"
                f" {case['seconds']:.0f} s of processor |"
            )

    def agreement(self) -> Iterator[str]:
        """Constants of disjoint flights beside each other."""
        yield ""
        yield "| set | constant | splits | largest over smallest | pairs within 95 % |"
        yield "|---|---|---|---|---|"
        for flights in self.sets:
            cases = [self.fitted(flights, split) for split in flights.splits]
            good = [case for case in cases if "refused" not in case]
            for name in program.CONSTANTS:
                values = [case["constants"][name] for case in good]
                pairs = list(itertools.combinations(good, 2))
                inside = sum(_agree(one, other, name) for one, other in pairs)
                listed = ", ".join(f"{value:.3g}" for value in values)
                spread = max(values) / min(values) if len(values) > 1 else float("nan")
                yield (
                    f"| {flights.name} | {name} | {listed} | {spread:.3f} |"
                    f" {inside} of {len(pairs)} |"
                )

    def find(self) -> Iterator[str]:
        """What ``discrepancy`` names, and the held-out gap before and after."""
        yield ""
        yield "| set | held-out gap | named | changed | worse channels | left | processor s |"
        yield "|---|---|---|---|---|---|---|"
        for flights, split in self._splits():
            case = self.fitted(flights, split)
            found = case if "refused" in case else self.searched(flights, split)
            yield _finding(f"{flights.name} {split.name}", found)
        yield from self._payload()

    def accept(self) -> Iterator[str]:
        """Each line of acceptance that a folder of flights can show."""
        number = 0
        for passed, text in self._accepted():
            number += 1
            self.failed |= not passed
            yield f"{'pass' if passed else 'FAIL'}  {text}"
        if number == 0:
            self.failed = True
            yield f"FAIL  {self.data}: there is none of the sets in it"

    def _accepted(self) -> Iterator[acceptance.Line]:
        for flights in self.sets:
            cases = []
            for split in flights.splits:
                label = f"{flights.name} {split.name}"
                case = self.fitted(flights, split)
                if "refused" in case:
                    yield False, f"{label}: fitted; refused: {case['refused']}"
                    continue
                cases.append(case)
                reference = self.reference(flights, split)
                yield from acceptance.constants(label, case, reference)
                shares = {}
                for axis, name in (("roll", "c0"), ("pitch", "c1")):
                    gain = case["constants"][name] * reference["per_constant"]
                    one = reference[axis]
                    shares[axis] = self.explained(flights, split, axis, gain, one)
                yield from acceptance.predictions(label, case, shares, flights.measured)
                found = self.searched(flights, split)
                if "refused" in found:
                    yield False, f"{label}: searched; refused: {found['refused']}"
                else:
                    yield from acceptance.findings(label, flights.name, found)
            yield from acceptance.agreement(flights.name, cases)
        loaded = self._loaded()
        if loaded is not None:
            if "refused" in loaded:
                yield False, f"payload: searched; refused: {loaded['refused']}"
                return
            light = next(one for one in self.sets if one.name == "brushless")
            yield from acceptance.payload(loaded, self.searched(light, light.splits[0]))

    def _payload(self) -> Iterator[str]:
        found = self._loaded()
        if found is not None:
            yield _finding("payload, model brushless a", found)

    def _loaded(self) -> Case | None:
        """What is found on flights with payload by a model from others; None without these."""
        brushless = next((one for one in self.sets if one.name == "brushless"), None)
        folder = self.data / "imrc_payload"
        if brushless is None or not folder.is_dir():
            return None
        case = self.fitted(brushless, brushless.splits[0])
        if "refused" in case:
            return None
        flights = [folder / name for name in PAYLOAD]
        return self._kept(
            "find_payload",
            lambda: program.find(
                [flights[0], flights[2]],
                [flights[1], flights[3]],
                case["model"],
                self.results / "payload_report.json",
            ),
        )

    def fitted(self, flights: FlightSet, split: Split) -> Case:
        return self._kept(
            f"fit_{flights.name}_{split.name}",
            lambda: program.fitted(self.data, flights, split, self.results),
        )

    def searched(self, flights: FlightSet, split: Split) -> Case:
        """What ``discrepancy`` makes of the split's fitted model."""
        model = self.fitted(flights, split)["model"]
        return self._kept(
            f"find_{flights.name}_{split.name}",
            lambda: program.searched(self.data, flights, split, model, self.results),
        )

    def reference(self, flights: FlightSet, split: Split) -> Case:
        """Gains by axis, and what one unit of the program's constants is in the reference's.

        From PWM the reference's squared speeds are those of the profile's motor at the same
        voltage, and its lag is the fitted model's.
        """
        fitted, held = self._read(flights, split.fitted), self._read(flights, split.held)
        case = self.fitted(flights, split)
        lag, unit = None, 1.0
        if not flights.measured and "model" in case:
            volts = 1e3 * float(fitted[0].drive_v.mean())
            own, given = load_model(case["model"]).motor, load_vehicle(flights.vehicle).motor
            lag = 1.0 / (own.a1 + 2 * own.a2 * own.steady_rev_s(volts))
            slopes = [
                one.steady_rev_s(1.01 * volts) ** 2 - one.steady_rev_s(0.99 * volts) ** 2
                for one in (own, given)
            ]
            unit = slopes[0] / slopes[1]
        made: Case = {"per_constant": unit}
        for axis in ("roll", "pitch"):
            one = reference_gain(fitted, axis, lag)
            made[axis] = {
                "gain": one.gain,
                "stderr": one.stderr,
                "delay_s": one.delay_s,
                "shape_s": one.shape_s,
                "held": explained(held, axis, one.gain, one.delay_s, one.shape_s),
            }
        return made

    def explained(
        self, flights: FlightSet, split: Split, axis: str, gain: float, reference: Case
    ) -> float:
        held = self._read(flights, split.held)
        return explained(held, axis, gain, reference["delay_s"], reference["shape_s"])

    def _read(self, flights: FlightSet, names: tuple[str, ...]) -> list[Flight]:
        vehicle = load_vehicle(flights.vehicle)
        folder = self.data / flights.folder
        return [read_flight(folder / name, vehicle, flights.measured) for name in names]

    def _splits(self) -> Iterator[tuple[FlightSet, Split]]:
        for flights in self.sets:
            for split in flights.splits:
                yield flights, split

    def _kept(self, name: str, compute: Callable[[], Case]) -> Case:
        path = self.results / f"{name}.case.json"
        if not path.is_file() or path.stat().st_mtime < self.code_time:
            print(f"bench: {name}", file=sys.stderr, flush=True)
            path.write_text(json.dumps(compute()))
        kept: Case = json.loads(path.read_text())
        return kept


def _agree(one: Case, other: Case, name: str) -> bool:
    errors = [case["stderr"][name] for case in (one, other)]
    if None in errors:
        return False
    apart = abs(one["constants"][name] - other["constants"][name])
    return bool(apart <= 1.96 * (errors[0] ** 2 + errors[1] ** 2) ** 0.5)


def _finding(label: str, found: Case) -> str:
    if "refused" in found:
        return f"| {label} | refused: {found['refused']} | | | | | {found['seconds']:.0f} |"
    named = "; ".join(
        name + " " + ", ".join(f"{one['value']:.3g}" for one in parameters.values())
        for name, parameters in found["effects"].items()
    )
    changed = ", ".join(f"{one['name']} {one['percent']:+.0f} %" for one in found["base_changes"])
    channels = found["channels"]
    worse = [name for name, one in channels.items() if one["after"] > 1.02 * one["before"]]
    left = max(channels, key=lambda name: channels[name]["after"] / channels[name]["noise_floor"])
    over = channels[left]["after"] / channels[left]["noise_floor"]
    gap = found["gap"]
    return (
        f"| {label} | {gap['before']:.2f} -> {gap['after']:.2f} | {named or found['verdict']} |"
        f" {changed} | {', '.join(worse) or 'none'} | {left} {over:.1f} | {found['seconds']:.0f} |"
    )


if __name__ == "__main__":
    sys.exit(main())
