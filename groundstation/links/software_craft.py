"""The software craft on its own clock, commanded as a craft behind the daemon is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from groundstation.errors import BadInputError
from groundstation.links.command import LEAN, PLACE, Landing
from groundstation.links.crazyflie_connection import PLACE_MS, TABLE, THRUST
from groundstation.recording.mcap_file import session_metadata, write_mcap
from groundstation.recording.session import Recording, Table
from groundstation.telemetry.decoder import decode_all
from groundstation.telemetry.packet import TICK_S as DEVICE_TICK_S
from groundstation.telemetry.samples import RawBatch, SampleBatch

if TYPE_CHECKING:
    from firmware_sim.craft import CraftState

TICK_S = 0.01
READY_S = 4.0
"""From power-on until the gyro's offset is known and motors have been tested."""
ON_THE_WAY_S = 0.0041
"""From the moment that a packet tells of until it is heard."""
ORIGIN_NS = 1_000_000_000_000_000_000
"""Host time of power-on: no flight in fast time has one of its own."""


class SoftwareCraft:
    """What ``service.client.Pilot`` is to a flight; time passes in ``wait``, ``arm``, ``land`` and
    ``stop`` alone. It has a Flow deck.

    source: a TOML file of the stand-in's settings, the JSON file of a model, which then flies as
    its own filter estimates it, or the name of a vehicle (the reduced plant, so that a model can
    say all of it). more: settings over those. client: a name for the recording.

    Raises BadInputError for settings that are none, or firmware that cannot be flown so.
    """

    def __init__(self, source: str, client: str, **more: Any) -> None:
        from firmware_sim.craft import StandIn
        from firmware_sim.physics import craft_of, firmware_of
        from firmware_sim.settings import StandInSettings, load_settings

        try:
            match Path(source).suffix:
                case ".toml":
                    given = load_settings(Path(source))
                case ".json":
                    given = StandInSettings(plant="model", craft=source, estimated=True)
                case _:
                    given = StandInSettings(plant="reduced", craft=source)
            self.settings = msgspec.structs.replace(given, program="wait", **more)
            self.vehicle, _ = craft_of(self.settings)
            self._firmware = firmware_of(self.settings, self.vehicle)
            # what does not know its place cannot be flown by a program
            self.settings = msgspec.structs.replace(self.settings, flow_deck=True)
            self._craft = StandIn(self.settings)
        except (ValueError, OSError) as error:
            raise BadInputError(f"software craft {source}: {error}") from error
        if self._firmware != "2.x":
            raise BadInputError(
                f"software craft {source}: its firmware of {self._firmware} holds neither height"
                " nor place, so no program can fly it; take crazyflie21, crazyflie21plus or"
                " brushless"
            )
        self.client = client
        self.uri = f"software:{source}"
        self._now_s = 0.0
        self._height_m: float | None = None
        self._parts = [self._craft.advance(0.0)]
        self._states: list[CraftState] = []
        self._commands: list[dict[str, Any]] = []
        self._events: list[dict[str, Any]] = []

    @property
    def lease(self) -> dict[str, Any]:
        """As ``Pilot.lease``, without what nobody asks for here."""
        return {
            "uri": self.uri,
            "firmware": self._firmware,
            "holds_height": True,
            "holds_place": True,
            "software": True,
            "craft": {
                "uri": self.uri,
                "vehicle": self.vehicle.name,
                "firmware": self._firmware,
                "id": f"{self._craft.cpu_id:024x}",
            },
        }

    def now_s(self) -> float:
        """Of the craft's clock."""
        return self._now_s

    def wait(self, seconds: float = TICK_S) -> None:
        """Let the craft fly for so long."""
        self._now_s += seconds
        self._parts.append(self._craft.advance(self._now_s))
        if self._now_s >= 1e-3 * PLACE_MS * len(self._states):
            self._states.append(self._craft.state())

    @property
    def position_m(self) -> tuple[float, float, float]:
        """Where it really is: ahead and to the left of where it was switched on, up."""
        return self._craft.state().position_m

    @property
    def velocity_m_s(self) -> tuple[float, float, float]:
        """How fast it really is."""
        return self._craft.state().velocity_m_s

    def setpoint(
        self,
        roll_deg: float,
        pitch_deg: float,
        yaw_dps: float,
        thrust: int = 0,
        *,
        height_m: float | None = None,
        vx_m_s: float | None = None,
        vy_m_s: float | None = None,
    ) -> dict[str, Any]:
        """As ``Pilot.setpoint``: signs of the telemetry."""
        entry: dict[str, Any] = {
            "time_ns": self._time_ns(),
            "kind": "setpoint",
            "client": self.client,
            "roll_deg": roll_deg,
            "pitch_deg": pitch_deg,
            "yaw_dps": yaw_dps,
            "thrust": thrust,
        }
        more = {"height_m": height_m, "vx_m_s": vx_m_s, "vy_m_s": vy_m_s}
        entry |= {name: value for name, value in more.items() if value is not None}
        if height_m is None:
            self._craft.command(roll_deg, -pitch_deg, -yaw_dps, thrust)
        elif vx_m_s is None or vy_m_s is None:
            self._craft.command_height(roll_deg, -pitch_deg, -yaw_dps, height_m)
        else:
            self._craft.command_hover(vx_m_s, vy_m_s, -yaw_dps, height_m)
        self._height_m = height_m
        self._commands.append(entry)
        return self._answer()

    def parameters(self) -> dict[str, float]:
        from firmware_sim.physics import NAMES_OF_TODAY, PARAMETER_NAMES

        names = (*PARAMETER_NAMES, *NAMES_OF_TODAY)
        return {name: self._craft.get_parameter(name) for name in names}

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

    def land(self) -> str:
        """As the daemon lands a craft: level and slowly, without speed over ground."""
        answer = self._answer()
        landing = Landing(self._now_s, self._height_m, answer["height_m"])
        while (asked_m := landing.tick(self._now_s, answer["height_m"])) is not None:
            answer = self.setpoint(0.0, 0.0, 0.0, height_m=asked_m, vx_m_s=0.0, vy_m_s=0.0)
            self.wait()
        return "landed" if self.stop() == "stopped" else "landed, its motors still turn"

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
        if state.tumbled or not (state.armed or self._craft.arm(True)):
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
            Recording(
                path,
                "mcap",
                samples,
                commands=self._commands,
                events=self._events,
                tables={TABLE: self._table(samples)},
                metadata=metadata,
            ),
            path,
        )

    def _table(self, samples: SampleBatch) -> Table:
        """What a daemon's craft says of where it is, and of its thrust. The clock of its packets
        began anywhere."""
        states = self._states
        rows = np.array(
            [
                (*one.estimate_m, *one.estimate_m_s, *one.angles_deg[:2], one.thrust)
                for one in states
            ],
            np.float64,
        ).reshape(len(states), -1)
        names: tuple[str, ...] = (*PLACE, *LEAN, THRUST)
        if self.settings.plant != "faithful" and not self.settings.estimated:
            rows, names = rows[:, len(PLACE) :], names[len(PLACE) :]  # no filter says it
        time_s = np.array([one.time_s for one in states], np.float64)
        heard_s = 1e-9 * (samples.host_time_ns - ORIGIN_NS)
        began_s = float(np.median(samples.time_s - heard_s)) + ON_THE_WAY_S
        return Table(time_s + began_s, dict(zip(names, rows.T, strict=True)))

    def _time_ns(self) -> int:
        return ORIGIN_NS + round(self._now_s * 1e9)

    def _answer(self) -> dict[str, Any]:
        state = self._craft.state()
        roll, pitch, yaw = state.angles_deg
        names = ("x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s")
        place = dict(zip(names, (*state.estimate_m, *state.estimate_m_s), strict=True))
        return {
            "time_ns": self._time_ns(),
            "link_state": "streaming" if state.powered else "lost",
            "hindrance": "the craft lies upside down" if state.tumbled else "",
            "height_m": state.height_m,
            "place": {**place, "age_s": 0.0, "at_s": state.time_s},
            "telemetry": {
                "age_s": 0.0,
                "timestamp": round(state.time_s / DEVICE_TICK_S),
                "roll_deg": roll,
                "pitch_deg": -pitch,
                "yaw_deg": yaw,
                "gyro_dps": list(state.gyro_dps),
                "battery_v": state.battery_v,
                "motors": [motor / 65536.0 for motor in state.motors],
            },
        }
