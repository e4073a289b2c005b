"""groundstation: a hardware-in-the-loop ground station service for the Crazyflie quadrotor.

Programs, commands and examples import what ``PUBLIC`` lists straight from here
(docs/python_api.md). Each name is loaded when it is first used, so that importing the package costs
nothing; a type checker reads the imports below instead.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

__version__ = "1.0.0"

if TYPE_CHECKING:
    from groundstation.attitude.fusion import check_axes as check_axes
    from groundstation.attitude.fusion import complementary as complementary
    from groundstation.attitude.fusion import kalman as kalman
    from groundstation.attitude.fusion import rest_bias as rest_bias
    from groundstation.comparison.comparison import compare as compare
    from groundstation.control.design import cascade_limits as cascade_limits
    from groundstation.control.design import design_cascade as design_cascade
    from groundstation.control.design import robustness as robustness
    from groundstation.control.firmware_loop import gains_text as gains_text
    from groundstation.control.firmware_loop import load_gains as load_gains
    from groundstation.control.firmwares import PidGains as PidGains
    from groundstation.control.linear_loop import evaluate as evaluate
    from groundstation.discrepancy.engine import find_discrepancy as find_discrepancy
    from groundstation.dynamics.model import Model as Model
    from groundstation.dynamics.model import load_model as load_model
    from groundstation.dynamics.model import save_model as save_model
    from groundstation.dynamics.model import vehicle_model as vehicle_model
    from groundstation.dynamics.vehicle import Vehicle as Vehicle
    from groundstation.dynamics.vehicle import load_vehicle as load_vehicle
    from groundstation.errors import BadInputError as BadInputError
    from groundstation.errors import GroundStationError as GroundStationError
    from groundstation.identification.arx import Criterion as Criterion
    from groundstation.identification.arx import identify_arx as identify_arx
    from groundstation.identification.body import identify_body as identify_body
    from groundstation.identification.flight import hold_out as hold_out
    from groundstation.identification.motor.workflow import identify_motor as identify_motor
    from groundstation.identification.report import simulate_run as simulate_run
    from groundstation.identification.runs import Run as Run
    from groundstation.identification.runs import flights_of as flights_of
    from groundstation.identification.runs import parse_selection as parse_selection
    from groundstation.identification.runs import runs_of as runs_of
    from groundstation.prediction.prediction import fly_reference as fly_reference
    from groundstation.prediction.prediction import load_reference as load_reference
    from groundstation.prediction.prediction import predict_ahead as predict_ahead
    from groundstation.recording.formats import open_recording as open_recording
    from groundstation.recording.mcap_file import write_mcap as write_mcap
    from groundstation.recording.session import Recording as Recording
    from groundstation.service.client import Client as Client
    from groundstation.service.client import Pilot as Pilot
    from groundstation.service.client import live as live
    from groundstation.service.config import socket_path as socket_path
    from groundstation.telemetry.decoder import decode_all as decode_all
    from groundstation.telemetry.samples import RawBatch as RawBatch
    from groundstation.telemetry.samples import SampleBatch as SampleBatch

    fit_arx = identify_arx
    fit_body = identify_body
    fit_motor = identify_motor

PUBLIC = {
    "BadInputError": "errors.BadInputError",
    "Client": "service.client.Client",
    "Criterion": "identification.arx.Criterion",
    "GroundStationError": "errors.GroundStationError",
    "Model": "dynamics.model.Model",
    "PidGains": "control.firmwares.PidGains",
    "Pilot": "service.client.Pilot",
    "RawBatch": "telemetry.samples.RawBatch",
    "Recording": "recording.session.Recording",
    "Run": "identification.runs.Run",
    "SampleBatch": "telemetry.samples.SampleBatch",
    "Vehicle": "dynamics.vehicle.Vehicle",
    "cascade_limits": "control.design.cascade_limits",
    "check_axes": "attitude.fusion.check_axes",
    "compare": "comparison.comparison.compare",
    "complementary": "attitude.fusion.complementary",
    "decode_all": "telemetry.decoder.decode_all",
    "design_cascade": "control.design.design_cascade",
    "evaluate": "control.linear_loop.evaluate",
    "find_discrepancy": "discrepancy.engine.find_discrepancy",
    "fit_arx": "identification.arx.identify_arx",
    "fit_body": "identification.body.identify_body",
    "fit_motor": "identification.motor.workflow.identify_motor",
    "flights_of": "identification.runs.flights_of",
    "fly_reference": "prediction.prediction.fly_reference",
    "gains_text": "control.firmware_loop.gains_text",
    "hold_out": "identification.flight.hold_out",
    "kalman": "attitude.fusion.kalman",
    "live": "service.client.live",
    "load_gains": "control.firmware_loop.load_gains",
    "load_model": "dynamics.model.load_model",
    "load_reference": "prediction.prediction.load_reference",
    "load_vehicle": "dynamics.vehicle.load_vehicle",
    "open_recording": "recording.formats.open_recording",
    "parse_selection": "identification.runs.parse_selection",
    "predict_ahead": "prediction.prediction.predict_ahead",
    "rest_bias": "attitude.fusion.rest_bias",
    "robustness": "control.design.robustness",
    "runs_of": "identification.runs.runs_of",
    "save_model": "dynamics.model.save_model",
    "simulate_run": "identification.report.simulate_run",
    "socket_path": "service.config.socket_path",
    "vehicle_model": "dynamics.model.vehicle_model",
    "write_mcap": "recording.mcap_file.write_mcap",
}
"""Names that programs may rely on -> where below this package each is."""

FORMER = {
    "identify_arx": "fit_arx",
    "identify_body": "fit_body",
    "identify_motor": "fit_motor",
}
"""Names of 1.0, understood until 2.0 -> today's."""

if not TYPE_CHECKING:  # a checker would take every name for one that there is
    __all__ = sorted(PUBLIC)  # noqa: PLE0605

    def __getattr__(name):
        from importlib import import_module

        try:
            module, _, found = PUBLIC[FORMER.get(name, name)].rpartition(".")
        except KeyError:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
        return getattr(import_module(f"{__name__}.{module}"), found)

    def __dir__():
        return [*globals(), *__all__]
