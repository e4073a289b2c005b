"""What a motor's report draws: measured and simulated speeds, and what is left between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.fit_record import ResidualTest, Trace, liveliest, residual_test
from groundstation.identification.motor.fit import credible_rows
from groundstation.identification.motor.problem import MotorRun

DRAWN_S = 6.0


def motor_pictures(
    modelled: Sequence[tuple[MotorRun, NDArray[np.float64]]], fitted_rows: int
) -> tuple[list[Trace], list[ResidualTest]]:
    """Measured and simulated speed (n,), and the residuals, of runs."""
    traces, residuals = [], []
    for run, model in modelled:
        readings = np.isfinite(run.rev_s)
        rows = liveliest(run.voltage_mv, run.period_s, DRAWN_S)
        here = np.flatnonzero(readings[rows]) + rows.start
        traces.append(
            Trace(
                f"rotor speed, {run.name}",
                "rev/s",
                run.period_s * here,
                run.rev_s[here],
                model[here],
                "simulated from the voltage alone",
            )
        )
        good = credible_rows(run, model)
        residuals.append(
            residual_test(
                f"rotor speed, {run.name}",
                run.rev_s[good] - model[good],
                "armature voltage",
                run.voltage_mv[good],
                fitted_rows,
            )
        )
    return traces, residuals
