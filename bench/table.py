"""One row of the table that every part of the bench gives."""

from __future__ import annotations

from typing import Any, NamedTuple

TITLES = ("what", "measured", "reference", "ratio", "limit", "unit")


class Row(NamedTuple):
    """What was measured, and what it is held against.

    what: with the meaning of the reference in brackets, where it is not plain. reference: of the
    same run and unit, None where there is none. most, least: what the figure must keep.
    """

    what: str
    measured: float
    reference: float | None
    unit: str
    most: float | None = None
    least: float | None = None

    @property
    def ratio(self) -> float | None:
        return self.measured / self.reference if self.reference else None

    @property
    def met(self) -> bool | None:
        """Whether the limits are kept; None without one."""
        if self.most is None and self.least is None:
            return None
        return (self.most is None or self.measured <= self.most) and (
            self.least is None or self.measured >= self.least
        )

    def as_dict(self, part: str) -> dict[str, Any]:
        return {"part": part, **self._asdict(), "ratio": self.ratio, "met": self.met}

    def line(self) -> str:
        """Aligned with ``header``; a limit that is not kept is marked."""
        limits = [f"{sign} {limit:.4g}" for sign, limit in (("<=", self.most), (">=", self.least))
                  if limit is not None]  # fmt: skip
        cells = [
            f"{self.measured:.4g}",
            "-" if self.reference is None else f"{self.reference:.4g}",
            "-" if self.ratio is None else f"{self.ratio:.3g}",
            " ".join(limits) + ("" if self.met in (True, None) else " MISSED") or "-",
        ]
        return _aligned(self.what, *cells, self.unit)


def header() -> str:
    return _aligned(*TITLES)


def _aligned(what: str, *cells: str) -> str:
    measured, reference, ratio, limit, unit = cells
    return f"{what:<80} {measured:>10} {reference:>10} {ratio:>9} {limit:>14}  {unit}".rstrip()
