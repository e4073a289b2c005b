"""Whether a table's motors are a quadrotor's: no more than four of them move."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

ROTORS = 4
MOTOR = re.compile(r"mot|pwm|duty|out|control|esc|throttle|rotor|rpm|^m_?\d|^u_?\d", re.IGNORECASE)
"""Names of motors; of an array of anything, each number is something else."""
MOVES = 0.2
"""A motor moves where its column changes so often against the usual of those that are mapped: an
output that idles, or a servo that is set now and then, does not."""


def siblings(columns: Sequence[str], names: Collection[str]) -> list[str]:
    """Columns that are named as the motors' columns are, with another number: ``motor[4]`` beside
    ``motor[0]`` to ``motor[3]``."""
    patterns = set()
    for column in columns:
        numbered = re.fullmatch(r"(.*?)(\d+)(\D*)", column)
        if numbered and MOTOR.search(column.rpartition(".")[2]):
            patterns.add(rf"{re.escape(numbered[1])}\d{{1,2}}{re.escape(numbered[3])}")
    spelled = re.compile("|".join(sorted(patterns)) or r"(?!)")
    return sorted(name for name in set(names) - set(columns) if spelled.fullmatch(name))


def changes(values: NDArray[np.float64]) -> NDArray[np.intp]:
    """How often each column (n, k) takes a new value."""
    known = np.isfinite(values[1:]) & np.isfinite(values[:-1])
    return np.count_nonzero((values[1:] != values[:-1]) & known, axis=0)


def too_many(mapped: NDArray[np.intp], others: NDArray[np.intp], names: Sequence[str]) -> str:
    """Why these are no quadrotor's motors, or empty. mapped, others: how often the mapped ones and
    their siblings change; names: of the siblings."""
    usual = float(np.median(mapped)) if len(mapped) else 0.0
    if usual == 0.0:
        return ""
    also = [name for name, count in zip(names, others, strict=True) if count > MOVES * usual]
    moving = int(np.count_nonzero(mapped > MOVES * usual)) + len(also)
    if moving <= ROTORS:
        return ""
    listed = ", ".join(also[:4])
    return (
        f"not of a quadrotor ({moving} motors move, {listed} among them): its motors are left out"
    )
