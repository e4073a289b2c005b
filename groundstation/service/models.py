"""The models that jobs have made of the folder's recordings, and what each knows of its numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from groundstation.dynamics.meanings import arx_meaning, meaning_of
from groundstation.dynamics.model import (
    BodyConstants,
    Model,
    load_model,
    of_rates,
    origin_notes,
    origin_of,
)
from groundstation.dynamics.vehicle import MotorConstants
from groundstation.errors import BadInputError, GroundStationError
from groundstation.service.jobs import Job
from groundstation.text import printable

BUILT_IN = "thesis"
SIDE_95 = 1.96
"""Standard errors on either side of a value; fits have thousands of degrees of freedom."""
SAME = 1e-9
"""An account speaks of a constant while the two agree so closely; another fit moved it since."""


class ModelParameter(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One number of a model. low, high: 95 % interval; None where nobody has estimated it, and
    ``origin`` says where it comes from. meaning: in words."""

    name: str
    value: float
    unit: str
    low: float | None
    high: float | None
    origin: Literal["fitted", "profile", "given"]
    meaning: str


class ModelEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A model of the recordings folder, or the built-in one. id: of the job that made it. kind: of
    that job. recordings, validate: what it was made from, and held out. file, report: paths.
    notes: what its user must know. problem: why it cannot be read; then nothing else is known."""

    id: str
    kind: str
    made_ns: int = 0
    vehicle: str = ""
    recordings: list[str] = []
    validate: list[str] = []
    parameters: list[ModelParameter] = []
    effects: list[str] = []
    notes: list[str] = []
    file: str | None = None
    report: str | None = None
    problem: str = ""


class Models:
    """What jobs have left in the folder. jobs: their entries."""

    def __init__(self, jobs: Callable[[], Sequence[Job]]) -> None:
        self._jobs = jobs
        self._read: dict[tuple[str, int], ModelEntry] = {}

    def entries(self) -> list[ModelEntry]:
        """The built-in one, then the folder's, the oldest first. Reads files: not for the event
        loop."""
        built_in = _described(Job(id=BUILT_IN, kind="fit", recordings=[]), load_model(BUILT_IN))
        return [
            msgspec.structs.replace(built_in, kind="built-in"),
            *(self._entry(job, job.model_file) for job in self._jobs() if job.model_file),
        ]

    def file(self, name: str) -> str:
        """What ``--model`` takes for a model of that id. Raises BadInputError for no model."""
        if name == BUILT_IN:
            return name
        for job in self._jobs():
            if job.id == name and job.model_file:
                return job.model_file
        raise BadInputError(f"{name}: no such model; GET /models lists those there are")

    def _entry(self, job: Job, file: str) -> ModelEntry:
        """Read once, as long as the file stays as it is."""
        try:
            key = file, Path(file).stat().st_mtime_ns
            if key not in self._read:
                self._read[key] = _described(job, load_model(file))
            return self._read[key]
        except (GroundStationError, OSError) as error:
            return ModelEntry(id=job.id, kind=job.kind, problem=printable(str(error)))


def _described(job: Job, model: Model) -> ModelEntry:
    return ModelEntry(
        id=job.id,
        kind=job.kind,
        made_ns=job.ended_ns,
        vehicle=model.vehicle,
        recordings=job.recordings,
        validate=job.validate,
        parameters=list(_parameters(model)),
        effects=[term.name for term in model.effects],
        notes=origin_notes(model) + _warnings(model),
        file=job.model_file,
        report=job.report,
    )


def _parameters(model: Model) -> Iterator[ModelParameter]:
    origins = origin_of(model)
    parts: dict[str, MotorConstants | BodyConstants | None] = {
        "motor": model.motor,
        "body": model.body,
    }
    for part, constants in parts.items():
        if constants is None:
            continue
        for key, value in msgspec.structs.asdict(constants).items():
            name = f"{part}.{key}"
            unit, meaning = meaning_of(name)
            origin = model.origin.get(name, origins[part])
            stderr = _constant_stderr(model, part, key, value) if origin == "fitted" else None
            yield _parameter(name, value, unit, stderr, origin, meaning)
    for axis, one in (model.arx or {}).items():
        account = _mapping(_mapping(model.fit.get("arx"), "axes"), axis)
        for letter, values in (("a", one.a), ("b", one.b)):
            for order, value in enumerate(values, 1):
                key = f"{letter}{order}"
                stderr = _stderr(account, key, value) if origins["arx"] == "fitted" else None
                unit, meaning = arx_meaning(key, one, rates=of_rates(model))
                yield _parameter(f"arx.{axis}.{key}", value, unit, stderr, origins["arx"], meaning)
    for term in model.effects:
        for key, found in term.parameters.items():
            origin = "given" if found.stderr is None else "fitted"
            name = f"{term.name}.{key}"
            meaning = meaning_of(name)[1]
            yield _parameter(name, found.value, found.unit, found.stderr, origin, meaning)


def _parameter(
    name: str, value: float, unit: str, stderr: float | None, origin: Any, meaning: str
) -> ModelParameter:
    known = stderr is not None and math.isfinite(stderr)
    side = SIDE_95 * stderr if stderr is not None and known else None
    return ModelParameter(
        name=name,
        value=value,
        unit=unit,
        low=None if side is None else value - side,
        high=None if side is None else value + side,
        origin=origin,
        meaning=meaning,
    )


def _constant_stderr(model: Model, part: str, key: str, value: float) -> float | None:
    """Of a constant, from the account that its value comes from; None where none is."""
    for change in _rows(model.fit.get("discrepancy"), "base_changes"):
        if change.get("name") == key and _same(change.get("to"), value):
            found = change.get("stderr")
            return float(found) if isinstance(found, int | float) else None
    return _stderr(model.fit.get(part), key, value)


def _stderr(account: Any, key: str, value: float) -> float | None:
    """Of a number that a fit's account has estimated; None where it speaks of another value."""
    estimates = _mapping(account, "estimates")
    columns = (estimates.get(name) or () for name in ("names", "values", "stderr"))
    for name, estimated, stderr in zip(*columns, strict=False):
        if name == key and _same(estimated, value):
            return float(stderr)
    return None


def _mapping(account: Any, name: str) -> Mapping[str, Any]:
    """A part of an account, empty where it is not there or something else."""
    part = account.get(name) if isinstance(account, Mapping) else None
    return part if isinstance(part, Mapping) else {}


def _same(one: Any, other: float) -> bool:
    return isinstance(one, int | float) and math.isclose(one, other, rel_tol=SAME)


def _rows(account: Any, name: str) -> list[Mapping[str, Any]]:
    rows = account.get(name) if isinstance(account, Mapping) else None
    return [row for row in rows if isinstance(row, Mapping)] if isinstance(rows, list) else []


def _warnings(model: Model) -> list[str]:
    """What the fits said of themselves."""
    found = []
    for account in model.fit.values():
        said = account.get("warnings") if isinstance(account, Mapping) else None
        found += [printable(str(line)) for line in said] if isinstance(said, list) else []
    return found
