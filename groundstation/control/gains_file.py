"""Gains in a TOML file: the thesis's form by axis, or the firmware's by parameter name.

[roll]                        firmware = "2014"
kp = 1.5e6                    "pid_rate.roll_kp" = 5.1
kd = 1.0e4                    "pid_attitude.roll_kp" = 3.2

The names are those of both firmwares and the numbers mean other things to each: a file that names
none holds gains of 2014's.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from groundstation.control.firmware_loop import require_gains
from groundstation.control.firmwares import RELEASES, Release
from groundstation.control.pid import PidGains, require_finite
from groundstation.documents import decode_toml, explained, read_document, seems
from groundstation.errors import BadInputError
from groundstation.telemetry.arrays import AXES

FIRMWARE = "firmware"
LOOP = "loop"
BY_AXIS = ("direct", "whole")
UNNAMED: Release = "2014"


def load_gains(path: str | Path) -> dict[str, PidGains] | dict[str, float]:
    """Gains by axis (thesis) or by parameter (firmware).

    Raises BadInputError naming what is wrong: no file, no TOML, an unknown name, a number that
    no gain can be.
    """
    where = f"gains {path}"
    table = _read(path, where)
    _named(table.pop(FIRMWARE, None), where)
    _loop(table.pop(LOOP, None), where)
    if not table:
        raise BadInputError(f"{where}: holds no gains")
    if any(name in table for name in AXES):
        return {axis: _of_axis(value, f"{where}: {axis}") for axis, value in table.items()}
    values = {}
    for name, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BadInputError(
                f'{where}: {name} is no number; write "pid_rate.roll_kp" = 5.1 with quotes'
            )
        values[name] = float(value)
    require_gains(values, where)
    return values


def firmware_of_gains(path: str | Path) -> Release | None:
    """The firmware that a file of gains is for; None where it names none.

    Raises as ``load_gains``.
    """
    where = f"gains {path}"
    return _named(_read(path, where).get(FIRMWARE), where)


def loop_of_gains(path: str | Path) -> str | None:
    """The loop, direct or whole, that a file of gains by axis is for; None where it names none.

    Raises as ``load_gains``.
    """
    where = f"gains {path}"
    return _loop(_read(path, where).get(LOOP), where)


def require_gains_of(
    path: str | Path, release: Release, whose: str, *, said: str | None = None
) -> None:
    """Raises BadInputError where a file of the firmware's gains is for another release.

    whose: what flies ``release``, in words. said: the release that the user says the file is for.
    """
    named = firmware_of_gains(path)
    if said is not None and named is not None and named != said:
        raise BadInputError(f"gains {path}: for firmware {named}, --firmware says {said}")
    if (named or said or UNNAMED) == release:
        return
    what = f"for firmware {named or said}"
    if not (named or said):
        what = f'taken for firmware {UNNAMED}, for no line says firmware = "{release}"'
    raise BadInputError(
        f"gains {path}: {what}; {whose} flies {release}, where the same names mean other numbers"
    )


def gains_text(
    gains: Mapping[str, PidGains] | Mapping[str, float],
    release: Release | None = None,
    loop: str | None = None,
) -> str:
    """What ``load_gains`` reads back to the same numbers. release, loop: whose gains they are."""
    lines = [f'{FIRMWARE} = "{release}"'] if release else []
    lines += [f'{LOOP} = "{loop}"'] if loop else []
    for name, value in gains.items():
        if isinstance(value, PidGains):
            lines += [
                f"[{name}]",
                *(f"{k} = {v!r}" for k, v in msgspec.structs.asdict(value).items()),
            ]
        else:
            lines.append(f'"{name}" = {value!r}')
    return "\n".join(lines) + "\n"


def _read(path: str | Path, where: str) -> dict[str, Any]:
    content = b""
    try:
        content = read_document(Path(path))
        return decode_toml(content, dict[str, Any])
    except (OSError, ValueError) as error:
        raise BadInputError(f"{where}: cannot be read: {error}{seems(content)}") from error


def _named(value: Any, where: str) -> Release | None:
    for release in RELEASES:
        if value == release:
            return release
    if value is not None:
        raise BadInputError(f"{where}: {FIRMWARE} is {value!r}, there are {', '.join(RELEASES)}")
    return None


def _loop(value: Any, where: str) -> str | None:
    if value is not None and value not in BY_AXIS:
        raise BadInputError(f"{where}: {LOOP} is {value!r}, there are {', '.join(BY_AXIS)}")
    return None if value is None else str(value)


def _of_axis(value: Any, where: str) -> PidGains:
    if where.rsplit(" ", 1)[-1] not in AXES:
        raise BadInputError(f"{where} is no axis: there are {', '.join(AXES)}")
    try:
        gains = msgspec.convert(value, PidGains, strict=False)
    except msgspec.ValidationError as error:
        raise BadInputError(f"{where}: {explained(error, PidGains)}") from error
    require_finite(gains, where)
    return gains
