"""What has been flown and said: a file in the folder, from which ``learn`` goes on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from groundstation.control.programme import LOW_BATTERY
from groundstation.errors import BadInputError

JOURNAL = "learn.json"


class Flown(msgspec.Struct, frozen=True):
    """What a pilot says after a landing. aborted: why, or empty. seconds: in the air. gains: those
    that flew."""

    aborted: str
    seconds: float
    gains: dict[str, float]


class Landed(msgspec.Struct, frozen=True, kw_only=True):
    """One flight. seconds: from switching on. battery: which one, from 1. timeline: as
    ``FlightPlan.timeline``. aborted: why, or empty. gains: that flew."""

    file: str
    purpose: str
    seconds: float
    battery: int
    timeline: list[dict[str, Any]]
    aborted: str = ""
    gains: dict[str, float] = {}


class Task(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What was asked for, and stays so when it goes on. hide: a seed, or None."""

    link: str
    vehicle: str
    height_m: float
    reach_m: float
    seed: int
    batteries: int
    hide: int | None = None


class Journal(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """flights: in order, those cut short too. said: after each landing. gains: what became of the
    new ones: ``written``, ``put back`` or why there are none; former: those before."""

    task: Task
    flights: list[Landed] = []
    said: list[str] = []
    gains: str = ""
    former: dict[str, float] = {}
    seconds: float = 0.0

    def good(self, file: str) -> Landed | None:
        """A flight that was flown to its end."""
        return next((one for one in self.flights if one.file == file and not one.aborted), None)

    @property
    def batteries(self) -> int:
        return max((one.battery for one in self.flights), default=1)

    @property
    def is_empty(self) -> bool:
        """Whether the present one ended the last flight."""
        return bool(self.flights) and self.flights[-1].aborted.startswith(LOW_BATTERY)

    @property
    def on_battery_s(self) -> float:
        """Flown on the present one."""
        return sum(one.seconds for one in self.flights if one.battery == self.batteries)

    def save(self, folder: Path) -> None:
        """Whole or not at all."""
        partial = folder / f".{JOURNAL}"
        try:
            partial.write_bytes(msgspec.json.format(msgspec.json.encode(self), indent=1))
            partial.replace(folder / JOURNAL)
        except OSError as error:
            raise BadInputError(
                f"{folder / JOURNAL}: cannot be written: {error.strerror}"
            ) from error


def journal_in(folder: Path) -> Journal | None:
    """That of a folder in which something was learnt; None where nothing was.

    Raises BadInputError where it cannot be read.
    """
    path = folder / JOURNAL
    try:
        return msgspec.json.decode(path.read_bytes(), type=Journal)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError) as error:
        raise BadInputError(
            f"{path}: cannot be read ({error}); learn in another folder with -o"
        ) from error
