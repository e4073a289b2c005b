"""groundstation: a hardware-in-the-loop ground station service for the Crazyflie quadrotor.

Programs import what ``PUBLIC`` lists straight from here (docs/python_api.md); each name is loaded
from its module when it is first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from typing import Any

__version__ = "1.0.0"

PUBLIC: dict[str, tuple[str, ...]] = {
    "recording.open_recording": ("open_recording",),
    "recording.session": ("Recording",),
    "recording.recording_file": ("write_mcap",),
    "telemetry.samples": ("RawBatch", "SampleBatch"),
    "telemetry.decoder": ("decode_all",),
    "identification.division": ("hold_out",),
    "identification.runs": ("Run", "runs_of"),
    "identification.segments": ("parse_selection",),
    "identification.motor.workflow": ("identify_motor",),
    "identification.body.workflow": ("identify_body",),
    "identification.arx.fit": ("Criterion",),
    "identification.arx.workflow": ("identify_arx",),
    "identification.replayed": ("simulate_run",),
    "dynamics.model": ("Model", "load_model", "save_model", "vehicle_model"),
    "dynamics.vehicle": ("Vehicle", "load_vehicle"),
    "dynamics.reference": ("load_reference",),
    "prediction.reference_flight": ("fly_reference",),
    "prediction.prediction": ("predict_ahead",),
    "attitude.filters": ("complementary", "kalman"),
    "attitude.sensors": ("rest_bias",),
    "attitude.axis_check": ("check_axes",),
    "control.pid": ("PidGains",),
    "control.evaluate": ("evaluate",),
    "control.firmware_design": ("cascade_limits", "design_cascade", "robustness"),
    "control.gains_file": ("gains_text", "load_gains"),
    "identification.recordings": ("flights_of",),
    "comparison.comparison": ("compare",),
    "discrepancy.engine": ("find_discrepancy",),
    "service.client": ("Client", "Pilot", "live"),
    "service.config": ("socket_path",),
    "errors": ("BadInputError", "GroundStationError"),
}
"""Module below this package -> the names that programs may rely on."""

_MODULES = {name: module for module, names in PUBLIC.items() for name in names}

__all__ = sorted(_MODULES)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    from importlib import import_module

    try:
        module = _MODULES[name]
    except KeyError:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
    return getattr(import_module(f"{__name__}.{module}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
