"""The software craft on its own clock, commanded as a craft behind the daemon is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from groundstation.errors import BadInputError
from groundstation.recording.recording_file import session_metadata, write_mcap
from groundstation.recording.session import Recording
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.samples import RawBatch

TICK_S = 0.01
READY_S = 4.0
"""From power-on until the gyro's offset is known and motors have been tested."""
ORIGIN_NS = 1_000_000_000_000_000_000
"""Host time of power-on: no flight in fast time has one of its own."""


class SoftwareCraft:
    """What ``service.client.Pilot`` is to a flight; time passes in ``wait`` alone.

    source: a TOML file of the stand-in's settings, or the name of a vehicle (the reduced plant, so
    that a model can say all of it). more: settings over those. client: a name for the recording.

    Raises BadInputError for settings that are none.
    """

    def __init__(self, source: str, client: str, **more: Any) -> None:
        from firmware_sim.craft import StandIn
        from firmware_sim.physics import craft_of, firmware_of
        from firmware_sim.settings import StandInSettings, load_settings

        try:
            given = (
                load_settings(Path(source))
                if Path(source).suffix == ".toml"
                else StandInSettings(plant="reduced", craft=source)
            )
            self.settings = msgspec.structs.replace(given, program="wait", **more)
            self.vehicle, _ = craft_of(self.settings)
            self._firmware = firmware_of(self.settings, self.vehicle)
            if self._firmware == "2.x":
                # one that cannot be told heights cannot be flown by a program
                self.settings = msgspec.structs.replace(self.settings, height_deck=True)
            self._craft = StandIn(self.settings)
        except (ValueError, OSError) as error:
            raise BadInputError(f"software craft {source}: {error}") from error
        self.client = client
        self.uri = f"software:{source}"
        self._now_s = 0.0
        self._parts = [self._craft.advance(0.0)]
        self._commands: list[dict[str, Any]] = []
        self._events: list[dict[str, Any]] = []

    @property
    def lease(self) -> dict[str, Any]:
        holds = self._firmware == "2.x"
        return {"uri": self.uri, "firmware": self._firmware, "holds_height": holds}

    def now_s(self) -> float:
        """Of the craft's clock."""
        return self._now_s

    def wait(self, seconds: float = TICK_S) -> None:
        """Let the craft fly for so long."""
        self._now_s += seconds
        self._parts.append(self._craft.advance(self._now_s))

    @property
    def position_m(self) -> tuple[float, float, float]:
        """What an onlooker sees: ahead, to the left, up."""
        return self._craft.state().position_m

    @property
    def heading_rad(self) -> float:
        return float(np.radians(self._craft.state().angles_deg[2]))

    def setpoint(
        self,
        roll_deg: float,
        pitch_deg: float,
        yaw_dps: float,
        thrust: int = 0,
        *,
        height_m: float | None = None,
    ) -> dict[str, Any]:
        """As ``Pilot.setpoint``: signs of the telemetry."""
        entry: dict[str, Any] = {
            "time_ns": self._time_ns(), "kind": "setpoint", "client": self.client,
            "roll_deg": roll_deg, "pitch_deg": pitch_deg, "yaw_dps": yaw_dps, "thrust": thrust,
        }  # fmt: skip
        if height_m is None:
            self._craft.command(roll_deg, -pitch_deg, -yaw_dps, float(thrust))  # type: ignore[arg-type]
        else:
            entry["height_m"] = height_m
            self._craft.command_height(roll_deg, -pitch_deg, -yaw_dps, height_m)
        self._commands.append(entry)
        return self._answer()

    def parameters(self) -> dict[str, float]:
        from firmware_sim.physics import PARAMETER_NAMES

        return {name: self._craft.get_parameter(name) for name in PARAMETER_NAMES}

    def write(self, values: dict[str, float]) -> dict[str, float]:
        for name, value in values.items():
            self._craft.set_parameter(name, value)
            self._commands.append(
                {
                    "time_ns": self._time_ns(),
                    "kind": "parameter",
                    "client": self.client,
                    "name": name,
                    "value": value,
                }
            )
        return {name: self._craft.get_parameter(name) for name in values}

    def mark(self, text: str, **details: Any) -> None:
        self._events.append(
            {"time_ns": self._time_ns(), "kind": "mark", "text": text, "details": details}
        )

    def stop(self) -> str:
        """Zero thrust and no arms: what the motors then do."""
        for _ in range(20):
            self._craft.command(0.0, 0.0, 0.0, 0)
            self.wait()
        self._craft.arm(False)
        self.wait(0.5)
        return "stopped" if not any(self._craft.state().motors) else "still turning"

    def arm(self) -> None:
        """Stand still until its checks are passed, then arm it; brushed craft arm themselves."""
        for _ in range(round(READY_S / TICK_S)):
            self.setpoint(0.0, 0.0, 0.0, 0)
            self.wait()
        state = self._craft.state()
        arms = self._firmware == "2.x"
        if state.tumbled or (arms and not (state.armed or self._craft.arm(True))):
            raise BadInputError(f"{self.uri}: it cannot be armed; does it lie on its back?")

    def save(self, path: Path) -> None:
        """Everything heard and commanded since power-on, as a new recording."""
        packets = np.concatenate([part for part, _ in self._parts])
        arrival_s = np.concatenate([times for _, times in self._parts])
        stamps = ORIGIN_NS + np.rint(arrival_s * 1e9).astype(np.int64)
        samples, _ = decode_all(RawBatch(packets, stamps))
        metadata = {
            "session": session_metadata(self.uri),
            "vehicle": {"profile": self.vehicle.name},
        }
        write_mcap(
            Recording(path, "mcap", samples, commands=self._commands, events=self._events,
                      metadata=metadata),
            path,
        )  # fmt: skip

    def _time_ns(self) -> int:
        return ORIGIN_NS + round(self._now_s * 1e9)

    def _answer(self) -> dict[str, Any]:
        state = self._craft.state()
        roll, pitch, _ = state.angles_deg
        return {
            "time_ns": self._time_ns(),
            "link_state": "streaming" if state.powered else "lost",
            "hindrance": "the craft lies upside down" if state.tumbled else "",
            "height_m": state.height_m,
            "telemetry": {
                "age_s": 0.0,
                "roll_deg": roll,
                "pitch_deg": -pitch,
                "gyro_dps": list(state.gyro_dps),
                "battery_v": state.battery_v,
                "motors": [motor / 65536.0 for motor in state.motors],
            },
        }
