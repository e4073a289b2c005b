"""Gains in a TOML file: the thesis's form by axis, or the firmware's by parameter name.

[roll]                        "pid_rate.roll_kp" = 5.1
kp = 1.5e6                    "pid_attitude.roll_kp" = 3.2
kd = 1.0e4
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from groundstation.control.firmware_loop import require_gains
from groundstation.control.pid import AXES, PidGains, require_finite
from groundstation.documents import decode_toml, explained, read_document, seems
from groundstation.errors import BadInputError


def load_gains(path: str | Path) -> dict[str, PidGains] | dict[str, float]:
    """Gains by axis (thesis) or by parameter (firmware).

    Raises BadInputError naming what is wrong: no file, no TOML, an unknown name, a number that
    no gain can be.
    """
    where = f"gains {path}"
    content = b""
    try:
        content = read_document(Path(path))
        table = decode_toml(content, dict[str, Any])
    except (OSError, ValueError) as error:
        raise BadInputError(f"{where}: cannot be read: {error}{seems(content)}") from error
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


def gains_text(gains: Mapping[str, PidGains] | Mapping[str, float]) -> str:
    """What ``load_gains`` reads back to the same numbers."""
    lines = []
    for name, value in gains.items():
        if isinstance(value, PidGains):
            lines += [
                f"[{name}]",
                *(f"{k} = {v!r}" for k, v in msgspec.structs.asdict(value).items()),
            ]
        else:
            lines.append(f'"{name}" = {value!r}')
    return "\n".join(lines) + "\n"


def _of_axis(value: Any, where: str) -> PidGains:
    if where.rsplit(" ", 1)[-1] not in AXES:
        raise BadInputError(f"{where} is no axis: there are {', '.join(AXES)}")
    try:
        gains = msgspec.convert(value, PidGains, strict=False)
    except msgspec.ValidationError as error:
        raise BadInputError(f"{where}: {explained(error, PidGains)}") from error
    require_finite(gains, where)
    return gains
