"""What has been flown and said: a file in the folder, from which ``learn`` goes on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from groundstation.control.programme import LOW_BATTERY
from groundstation.documents import decode_json, read_document
from groundstation.errors import BadInputError
from groundstation.paths import write_whole

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


class Craft(msgspec.Struct, frozen=True, kw_only=True):
    """What a craft behind the daemon says of itself. firmware: whose loops it flies. id: its own
    number; empty where it does not say."""

    uri: str
    vehicle: str
    firmware: str
    id: str

    def is_same(self, other: Craft) -> bool:
        """By number, vehicle and firmware; by its address where none says a number."""
        if self.id and other.id:
            where = self.id == other.id
        else:
            where = not (self.id or other.id) and self.uri == other.uri
        return where and (self.vehicle, self.firmware) == (other.vehicle, other.firmware)

    def __str__(self) -> str:
        number = f", number {self.id}" if self.id else ""
        return f"{self.vehicle or 'a craft'} at {self.uri}, firmware {self.firmware}{number}"


class Task(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What was asked for, and stays so when it goes on. hide: a seed, or None. craft: the daemon's
    that is learnt, None before it was there and for a software craft."""

    link: str
    vehicle: str
    height_m: float
    reach_m: float
    seed: int
    batteries: int
    hide: int | None = None
    craft: Craft | None = None


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
        """Whole or not at all. Raises BadInputError."""
        try:
            text = msgspec.json.format(msgspec.json.encode(self), indent=1)
            write_whole(folder / JOURNAL, text, durable=True)
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
        return decode_json(read_document(path), Journal)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise BadInputError(
            f"{path}: cannot be read ({why}); learn in another folder with -o"
        ) from error
